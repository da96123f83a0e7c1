"""What a perfect calibration of a rig would find, as it travels in a file; `sequence.calibration` reads it."""

from __future__ import annotations

from typing import Any

import numpy as np

from oysterbench.core.geometry import transform
from oysterbench.recipe import CameraRecipe, ImuRecipe, RigRecipe, ScannerRecipe, SiteRecipe, SonarRecipe
from oysterbench.scene.rig import GRAVITY, PORT_INDEX, camera_matrix, camera_pose, imu_pose
from oysterbench.sensors import acoustics, dvl, echoes, pressure, sonar

INERTIAL_NOISE = ("noise_density", "turn_on", "bias_instability", "bias_tau_s")


def rig_calibration(rig: RigRecipe, site: SiteRecipe) -> dict[str, Any]:
    """calibration.json of a rig at a site, as JSON values; what the rig lacks is absent."""
    document: dict[str, Any] = {
        "imu": _inertial(rig.imu),
        "cameras": {camera.name: _camera(camera) for camera in rig.camera},
    }
    if rig.sonar:
        document["sonars"] = {recipe.name: _sonar(recipe) for recipe in rig.sonar}
    if rig.scanner:
        document["scanners"] = {
            recipe.name: {**_echoes(recipe), "beam_rad": float(np.radians(recipe.beam_deg))} for recipe in rig.scanner
        }
    if rig.altimeter:
        document["altimeters"] = {
            recipe.name: {
                "beam_rad": float(np.radians(recipe.beam_deg)),
                "min_range_m": recipe.min_range_m,
                "max_range_m": recipe.max_range_m,
                "T_base_sensor": acoustics.mount_pose(recipe).tolist(),
            }
            for recipe in rig.altimeter
        }
    if rig.dvl is not None:
        document["dvl"] = {
            "T_base_sensor": transform(dvl.mount_rotation(rig.dvl), rig.dvl.position_m).tolist(),
            "beam_directions": dvl.beam_directions(rig.dvl).tolist(),
            "max_range_m": rig.dvl.max_range_m,
        }
    if rig.pressure is not None:
        document["pressure"] = {
            "T_base_sensor": transform(np.eye(3), rig.pressure.position_m).tolist(),
            "density": pressure.density(site),
            "atmosphere": pressure.ATMOSPHERE,
        }
    if rig.magnetometer is not None:
        document["magnetometer"] = {"T_base_sensor": imu_pose(rig.magnetometer).tolist()}
    return document


def _camera(camera: CameraRecipe) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "width": camera.width,
        "height": camera.height,
        "rate_hz": camera.rate_hz,
        "matrix": camera_matrix(camera).tolist(),
        "distortion_model": "equidistant" if camera.lens == "fisheye" else "plumb_bob",
        "distortion": [*camera.distortion, *([0.0] * (4 - len(camera.distortion)))],
        "T_base_cam": camera_pose(camera).tolist(),
    }
    if camera.port_mm is not None:
        entry["port"] = {"distance_m": camera.port_mm / 1e3, "index": PORT_INDEX}
    return entry


def _inertial(unit: ImuRecipe) -> dict[str, Any]:
    return {
        "rate_hz": unit.rate_hz,
        **{f"{which}_{key}": getattr(unit, f"{which}_{key}") for which in ("gyro", "accel") for key in INERTIAL_NOISE},
        "gyro_random_walk": unit.gyro_bias_walk,
        "accel_random_walk": unit.accel_bias_walk,
        "gravity": GRAVITY,
        "T_base_imu": imu_pose(unit).tolist(),
    }


def _sonar(recipe: SonarRecipe) -> dict[str, Any]:
    return {
        **_echoes(recipe),
        "beams": recipe.beams,
        "bins": recipe.bins,
        "azimuths_rad": sonar.beam_azimuths(recipe).tolist(),
        "vfov_rad": float(np.radians(recipe.vfov_deg)),
        "frequency_hz": 1e3 * recipe.frequency_khz,
    }


def _echoes(recipe: SonarRecipe | ScannerRecipe) -> dict[str, Any]:
    return {
        "ranges_m": echoes.bin_middles(recipe).tolist(),
        "amplitude_step": echoes.amplitude_step(recipe),
        "T_base_sensor": acoustics.mount_pose(recipe).tolist(),
    }
