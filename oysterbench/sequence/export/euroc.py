"""EuRoC/ASL folders: mav0/cam0, cam1, ..., imu0 and state_groundtruth_estimate0. The body is the IMU.

Kalibr's files for the same cameras and README.txt lie next to mav0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy

from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.export.kalibr import write_calibration
from oysterbench.sequence.export.parts import inertial_samples, number, numbers, sensor_poses, write_lines, write_png
from oysterbench.sequence.export.readme import truth_line, write_readme
from oysterbench.sequence.export.steps import Steps, frames
from oysterbench.sequence.truth import TRUTH
from oysterbench.sequence.types import CameraCalibration, ImuCalibration, Sequence

IMU_HEADER = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
TRUTH_HEADER = (
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
    "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],"
    "b_w_RS_S_z [rad s^-1],b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]"
)
OWN = (
    "mav0/*/sensor.yaml have the same; gravity, timeshift_cam_imu and readout_s in them are not of the layout.",
    "camchain-imucam.yaml and imu.yaml are Kalibr's. Stamps are in ns.",
)
DISTORTION_MODELS = {"plumb_bob": "radial-tangential", "equidistant": "equidistant"}


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write images as PNG, and IMU samples and states with all their digits."""
    root = folder / "mav0"
    T_imu_base = invert(sequence.imu_calibration.T_base_imu)
    steps.expect(frames(sequence, sequence.cameras))
    for index, (name, camera) in enumerate(sequence.cameras.items()):
        place = root / f"cam{index}"
        (place / "data").mkdir(parents=True)
        write_lines(place / "sensor.yaml", _camera_yaml(name, camera, T_imu_base @ camera.T_base_cam))
        rows = ["#timestamp [ns],filename"]
        for image in steps.counted(sequence.images(name)):
            write_png(place / "data" / f"{image.stamp_ns}.png", image.pixels)
            rows.append(f"{image.stamp_ns},{image.stamp_ns}.png")
        write_lines(place / "data.csv", rows)
    inertial = root / "imu0"
    inertial.mkdir(parents=True)
    write_lines(inertial / "sensor.yaml", _imu_yaml(sequence.imu_calibration))
    samples = (
        ",".join([str(sample.stamp_ns), *(repr(float(value)) for value in (*sample.gyro, *sample.accel))])
        for sample in inertial_samples(sequence)
    )
    write_lines(inertial / "data.csv", [IMU_HEADER, *samples])
    write_lines(root / "body.yaml", [f"comment: {sequence.name}"])
    notes = [f"cam{index} is {name}" for index, name in enumerate(sequence.cameras)]
    labels = {f"cam{index}": name for index, name in enumerate(sequence.cameras)}
    notes += write_calibration(sequence, folder, [f"/{label}/image_raw" for label in labels], "/imu0")
    own = (*OWN, truth_line(truth, "mav0/state_groundtruth_estimate0, of the IMU"))
    write_readme(sequence, folder, "EuRoC/ASL", labels, truth, own)
    if truth:
        _write_state(sequence, root / "state_groundtruth_estimate0")
        notes.append("the sequence has no biases of the IMU: those columns of the ground truth are nan")
    return notes


def _camera_yaml(name: str, camera: CameraCalibration, T_imu_cam: Array) -> list[str]:
    matrix, coefficients = camera.matrix, camera.distortion
    if camera.distortion_model == "plumb_bob" and not np.any(coefficients[4:]):
        coefficients = coefficients[:4]
    return [
        "sensor_type: camera",
        f"comment: {name}",
        *_pose_yaml(T_imu_cam),
        f"rate_hz: {camera.rate_hz:g}",
        f"resolution: [{camera.width}, {camera.height}]",
        "camera_model: pinhole",
        f"intrinsics: {numbers([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])}",
        f"distortion_model: {DISTORTION_MODELS[camera.distortion_model]}",
        f"distortion_coefficients: {numbers(coefficients)}",
        f"timeshift_cam_imu: {number(0.0 - camera.time_offset_s)}",  # not part of the layout: Kalibr's
        *([f"readout_s: {number(camera.readout_s)}"] if camera.readout_s else []),  # nor is this
    ]


def _imu_yaml(unit: ImuCalibration) -> list[str]:
    return [
        "sensor_type: imu",
        "comment: imu",
        *_pose_yaml(np.eye(4)),
        f"rate_hz: {unit.rate_hz:g}",
        f"gyroscope_noise_density: {number(unit.gyro_noise_density)}",
        f"gyroscope_random_walk: {number(unit.gyro_random_walk)}",
        f"accelerometer_noise_density: {number(unit.accel_noise_density)}",
        f"accelerometer_random_walk: {number(unit.accel_random_walk)}",
        f"gravity: {number(unit.gravity)}",  # not part of the layout, which has none
    ]


def _pose_yaml(T_body_sensor: Array) -> list[str]:
    return ["T_BS:", "  cols: 4", "  rows: 4", f"  data: {numbers(T_body_sensor)}"]


def _write_state(sequence: Sequence, folder: Path) -> None:
    """Write the pose of the IMU in map, and its velocity there: that of base_link plus rotation at the lever arm."""
    folder.mkdir()
    T_base_imu = sequence.imu_calibration.T_base_imu
    truth = sequence.truth()
    poses = sensor_poses(truth, T_base_imu)
    quaternions = scipy.spatial.transform.Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    velocities = _velocities(sequence, T_base_imu[:3, 3], truth.matrices[:, :3, :3])
    rows = [
        ",".join(
            [
                str(int(stamp)),
                *(repr(float(value)) for value in (*position, q[3], *q[:3], *velocity)),
                *["nan"] * 6,
            ]
        )
        for stamp, position, q, velocity in zip(truth.stamps_ns, poses[:, :3, 3], quaternions, velocities, strict=True)
    ]
    write_lines(folder / "data.csv", [TRUTH_HEADER, *rows])
    write_lines(folder / "sensor.yaml", ["sensor_type: visual-inertial", "comment: truth", *_pose_yaml(np.eye(4))])


def _velocities(sequence: Sequence, arm: Array, rotations: Array) -> Array:
    """Velocities (N, 3) m/s in map, of a point at `arm` (3,) m in base_link. NaN where the sequence has none."""
    if TRUTH not in (topic for topic, _, _ in sequence.contents()):
        return np.full((len(rotations), 3), np.nan)
    table = sequence.frame(TRUTH)
    velocity = table[["velocity_x", "velocity_y", "velocity_z"]].to_numpy()
    rate = table[["rate_x", "rate_y", "rate_z"]].to_numpy()
    return np.asarray(np.einsum("nij,nj->ni", rotations, velocity + np.cross(rate, arm)))
