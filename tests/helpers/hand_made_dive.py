"""A short dive with every kind of sensor, made by hand: level flight over a level bottom, each number by a formula."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import transform
from oysterbench.core.measurements import (
    Cloud,
    DvlMeasurement,
    ImuMeasurement,
    MagneticMeasurement,
    PressureMeasurement,
    RangeMeasurement,
    ScanPing,
    SonarImage,
)
from oysterbench.core.ros import EPOCH_NS, Message
from oysterbench.recipe import RigRecipe, parse_split
from oysterbench.sensors.camera import KIND as CAMERA
from oysterbench.sensors.camera_messages import camera_info, camera_topics, colour_message, layer_message, optical_frame
from oysterbench.sensors.clouds import cloud_message
from oysterbench.sensors.registry import kind_of
from oysterbench.sensors.sonar import KIND as SONAR
from oysterbench.sensors.sonar import SonarRecipe
from oysterbench.sequence.read import CALIBRATION, METADATA, OYSTERS
from oysterbench.sequence.truth import (
    rig_topics,
    static_transforms,
    transform_message,
    truth_message,
    truth_pose_message,
)
from oysterbench.sequence.write import SequenceWriter
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

BOTTOM_Z, FLIGHT_Z = -3.0, -1.8
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def turn(axis: str, degrees: float) -> np.ndarray:
    """Rotation matrix (3, 3)."""
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


DOWN = turn("y", 70) @ OPTICAL
WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
RIG = b"""[imu]
clock_offset_ms = 1.0
[[camera]]
name = "cam_left"
clock_offset_ms = 4.0
[[camera]]
name = "cam_right"
"""
SENSORS = """
[[scanner]]
name = "msis"
rate_hz = 20.0
[[altimeter]]
name = "alt"
rate_hz = 5.0
[dvl]
[pressure]
[magnetometer]
"""
BEAMS, BINS = 16, 40
JANUS = np.radians(22.5)
DIRECTIONS = np.array(
    [[np.sin(JANUS) * np.cos(a), np.sin(JANUS) * np.sin(a), -np.cos(JANUS)] for a in np.radians([45, 135, 225, 315])]
)
SPEED, RATE = 0.4, 0.2  # m/s along the path, rad/s about z


def camera(y: float) -> dict[str, Any]:
    return {
        "width": WIDTH,
        "height": HEIGHT,
        "rate_hz": 10.0,
        "matrix": [[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]],
        "distortion_model": "plumb_bob",
        "distortion": [0.0, 0.0, 0.0, 0.0],
        "T_base_cam": transform(DOWN, [0.2, y, 0.05]).tolist(),
    }


def calibration() -> dict[str, Any]:
    """In the shape of calibration.json."""
    level = transform(np.eye(3), [0.3, 0.0, -0.1]).tolist()
    return {
        "imu": {
            "rate_hz": 100.0,
            "gyro_noise_density": 1e-4,
            "gyro_random_walk": 1e-5,
            "gyro_turn_on": 1e-3,
            "accel_noise_density": 1e-3,
            "accel_random_walk": 1e-4,
            "accel_turn_on": 1e-2,
            "gravity": 9.80665,
            "T_base_imu": transform(
                Rotation.from_euler("z", 30, degrees=True).as_matrix(), [-0.1, 0.02, 0.03]
            ).tolist(),
        },
        "cameras": {"cam_left": camera(0.06), "cam_right": camera(-0.06)},
        "sonars": {
            "fls": {
                "beams": BEAMS,
                "bins": BINS,
                "azimuths_rad": np.linspace(0.6, -0.6, BEAMS).tolist(),
                "ranges_m": (0.1 + 0.1 * np.arange(BINS)).tolist(),
                "vfov_rad": 0.35,
                "frequency_hz": 750e3,
                "amplitude_step": 1e-4,
                "T_base_sensor": level,
            }
        },
        "scanners": {
            "msis": {
                "ranges_m": (0.1 * np.arange(1, 31)).tolist(),
                "beam_rad": 0.05,
                "amplitude_step": 1e-4,
                "T_base_sensor": level,
            }
        },
        "altimeters": {
            "alt": {
                "beam_rad": 0.5,
                "min_range_m": 0.3,
                "max_range_m": 100.0,
                "T_base_sensor": transform(
                    Rotation.from_euler("y", 90, degrees=True).as_matrix(), np.zeros(3)
                ).tolist(),
            }
        },
        "dvl": {"T_base_sensor": level, "beam_directions": DIRECTIONS.tolist(), "max_range_m": 50.0},
        "pressure": {"T_base_sensor": level, "density": 1010.0, "atmosphere": 101325.0},
        "magnetometer": {"T_base_sensor": level},
    }


def pose(t: float) -> np.ndarray:
    """T_map_base at t seconds: around a circle, at one depth."""
    yaw = RATE * t
    turn = Rotation.from_euler("z", yaw).as_matrix()
    return transform(turn, [SPEED / RATE * np.sin(yaw), SPEED / RATE * (1 - np.cos(yaw)), FLIGHT_Z])


def layers(t: float, name: str) -> dict[str, np.ndarray]:
    """What a camera sees of the level bottom, with two oysters on it, one of them in two pieces and with a hole."""
    T_map_cam = pose(t) @ np.array(calibration()["cameras"][name]["T_base_cam"])
    columns, rows = np.meshgrid(np.arange(WIDTH) - (WIDTH - 1) / 2, np.arange(HEIGHT) - (HEIGHT - 1) / 2)
    rays = np.stack([columns / FOCAL, rows / FOCAL, np.ones_like(rows)], axis=-1) @ T_map_cam[:3, :3].T
    depth = np.where(rays[..., 2] < -0.05, (BOTTOM_Z - T_map_cam[2, 3]) / np.minimum(rays[..., 2], -0.05), 0.0)
    instance = np.zeros((HEIGHT, WIDTH), dtype=np.uint16)
    shift = round(10 * t) % 8
    instance[20:30, 10 + shift : 24 + shift] = 7
    instance[23:26, 13 + shift : 16 + shift] = 0
    instance[34:37, 12 + shift : 20 + shift] = 7
    instance[15:20, 40:52] = 40_000
    instance[14, 45] = 40_000
    classes = np.where(instance > 0, 2, np.where(depth > 0, 1, 0)).astype(np.uint8)
    visibility = np.where(instance == 7, 0.5, np.where(instance > 0, 1.0, np.nan)).astype(np.float32)
    return {"depth": depth.astype(np.float32), "class": classes, "instance": instance, "visibility": visibility}


def colour(t: float, name: str) -> np.ndarray:
    generator = np.random.default_rng([round(1000 * t), len(name)])
    picture = np.full((HEIGHT, WIDTH, 3), (60, 90, 80), dtype=np.uint8)
    picture[layers(t, name)["instance"] > 0] = (150, 140, 120)
    return picture + generator.integers(0, 20, picture.shape, dtype=np.uint8)


@dataclass
class Measurements:
    """What went into the file, by what a reader calls it."""

    imu: list[ImuMeasurement] = field(default_factory=list)
    dvl: list[DvlMeasurement] = field(default_factory=list)
    pressure: list[PressureMeasurement] = field(default_factory=list)
    magnetometer: list[MagneticMeasurement] = field(default_factory=list)
    ranges: list[RangeMeasurement] = field(default_factory=list)
    sonar: list[SonarImage] = field(default_factory=list)
    scans: list[ScanPing] = field(default_factory=list)
    clouds: list[Cloud] = field(default_factory=list)
    poses: list[tuple[int, np.ndarray]] = field(default_factory=list)


def stamps(rate_hz: float, seconds: float) -> list[tuple[int, float]]:
    """Stamp and time of each sample."""
    times = np.arange(round(rate_hz * seconds)) / rate_hz
    return [(EPOCH_NS + round(t * 1e9), float(t)) for t in times]


def measurements(seconds: float = 2.0) -> Measurements:
    """Of all sensors but the cameras. The DVL loses its lock in the last half second."""
    made = Measurements()
    generator = np.random.default_rng(1)
    for stamp, _ in stamps(100, seconds):
        noise = generator.normal(size=6) * 0.01
        made.imu.append(
            ImuMeasurement(stamp, np.array([0, 0, RATE]) + noise[:3], np.array([0, 0, 9.80665]) + noise[3:])
        )
    for stamp, t in stamps(8, seconds):
        lock = t < seconds - 0.5
        valid = np.array([True, True, True, lock])
        ranges = np.where(valid, (FLIGHT_Z - 0.1 - BOTTOM_Z) / np.cos(JANUS), np.nan).astype(np.float32).astype(float)
        along = (DIRECTIONS @ [SPEED, 0, 0]).astype(np.float32).astype(float)
        covariance = np.diag([1e-4, 1e-4, 1e-6]) if lock else np.full((3, 3), np.nan)
        made.dvl.append(
            DvlMeasurement(
                stamp_ns=stamp,
                velocity=np.array([SPEED, 0.01 * t, 0]) if lock else np.full(3, np.nan),
                covariance=covariance,
                figure_of_merit=float(np.sqrt(np.trace(covariance))),
                altitude=1.0625 if lock else float("nan"),
                beam_directions=DIRECTIONS,
                beam_ranges=ranges,
                beam_velocities=np.where(valid, along, np.nan),
                beam_valid=valid,
            )
        )
    for stamp, t in stamps(20, seconds):
        made.pressure.append(
            PressureMeasurement(stamp, 101325.0 + 1010 * 9.80665 * 1.8 + 20 * round(3 * np.sin(9 * t)), 400.0)
        )
    for stamp, t in stamps(50, seconds):
        made.magnetometer.append(MagneticMeasurement(stamp, np.array([2e-5 * np.cos(RATE * t), 1e-6, -4e-5]), 9e-14))
    for stamp, t in stamps(5, seconds):
        made.ranges.append(
            RangeMeasurement(stamp, "alt", float("inf") if t > seconds - 0.3 else 1.1875 + round(5 * t) / 64)
        )
        pixels = generator.integers(0, 65536, (BINS, BEAMS)).astype(np.uint16)
        made.sonar.append(SonarImage(stamp, "fls", pixels))
        n = generator.integers(3, 30)
        made.clouds.append(
            Cloud(
                stamp_ns=stamp,
                sensor="fls",
                points=generator.normal(size=(n, 3)).astype(np.float32),
                intensity=generator.random(n).astype(np.float32),
                classes=generator.integers(0, 8, n).astype(np.uint8),
                instances=generator.integers(0, 65536, n).astype(np.uint16),
            )
        )
    for k, (stamp, _) in enumerate(stamps(20, seconds)):
        amplitudes = generator.integers(0, 65536, 30).astype(np.uint16)
        made.scans.append(ScanPing(stamp, "msis", np.radians(-60 + 1.8 * k), amplitudes))
    made.poses = [(stamp, pose(t)) for stamp, t in stamps(50, seconds)]
    return made


def rig() -> RigRecipe:
    """A rig with every sensor of the dive but its cameras and its imaging sonar."""
    return parse_split(TINY_SPLIT, "tiny.toml", rig_source=TINY_RIG + SENSORS).rig


def all_types() -> dict[str, str]:
    """Topic -> type, as `rig_topics` gives them for such a rig."""

    small = {topic: kind for topic, kind in rig_topics(rig()).items() if not topic.startswith("/cam_front/")}
    cameras = camera_topics("cam_left", ("depth", "class", "instance", "visibility")) | camera_topics("cam_right", ())
    return {**small, **cameras, "/fls/image": "sensor_msgs/msg/Image", "/fls/cloud": "sensor_msgs/msg/PointCloud2"}


def messages(seconds: float = 2.0, image_format: str = "png") -> list[Message]:
    """Every message of the dive, sensor after sensor."""
    made, known = measurements(seconds), calibration()
    frames = {"imu_link": known["imu"]["T_base_imu"], "dvl_link": known["dvl"]["T_base_sensor"]}
    frames |= {optical_frame(name): entry["T_base_cam"] for name, entry in known["cameras"].items()}
    placed = {
        name: (np.array(T)[:3, 3], Rotation.from_matrix(np.array(T)[:3, :3]).as_quat()) for name, T in frames.items()
    }
    sent = [static_transforms(EPOCH_NS, placed)]
    recipes = {recipe.block: recipe for recipe in rig().sensors}
    named: dict[str, Any] = {"altimeter": made.ranges, "scanner": made.scans}
    for block, recipe in recipes.items():
        kind = kind_of(recipe)
        measured = named[block] if block in named else getattr(made, block)
        sent += [message for measurement in measured for message in kind.encode(recipe, measurement)]
    sent += [
        message for image in made.sonar for message in SONAR.encode(SonarRecipe(name="fls", rate_hz=5.0), (image, None))
    ]
    sent += [cloud_message(cloud) for cloud in made.clouds]
    for stamp, T in made.poses:
        attitude = Rotation.from_matrix(T[:3, :3]).as_quat()
        sent.append(truth_message(stamp, T[:3, 3], attitude, np.array([SPEED, 0.0, 0.0]), np.array([0.0, 0.0, RATE])))
        sent.append(truth_pose_message(stamp, T[:3, 3], attitude))
        sent.append(transform_message(stamp, T[:3, 3], attitude))
    for name, entry in known["cameras"].items():
        for k, (stamp, t) in enumerate(stamps(10, seconds)):
            sent.append(camera_info(stamp, name, CAMERA.read_calibration(entry)))
            sent.append(colour_message(stamp, name, colour(t, name), 95, image_format))
            if name == "cam_left" and k % 5 == 0:
                sent += [layer_message(stamp, name, layer, pixels) for layer, pixels in layers(t, name).items()]
    return sent


def write_dive(path: Path, seconds: float = 2.0, image_format: str = "png", compress: bool = True) -> Path:
    """The dive as a sequence file, each topic in chunks of its own."""
    sent, types = messages(seconds, image_format), all_types()
    with open(path, "wb") as file:
        writer = SequenceWriter(file, types, compress)
        writer.metadata(METADATA, {"sequence": "hand-made", "split": "none", "split_version": "1.0"})
        writer.attachment(CALIBRATION, "application/json", json.dumps(calibration()).encode())
        writer.attachment(OYSTERS, "text/csv", b"id,state,x,y,z\n7,live,0.5,0.1,-3.0\n40000,box,0.8,-0.2,-3.0\n")
        writer.attachment("rig.toml", "application/toml", RIG)
        for topic in types:
            for message in sent:
                if message.topic == topic:
                    writer.write(message)
            writer.section()
        writer.finish()
    return path
