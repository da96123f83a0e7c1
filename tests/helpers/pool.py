"""Splits of a pool that is not there: recipes, ground truth that nobody rendered, and answers to send."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import transform
from oysterbench.core.ros import EPOCH_NS, TF_STATIC
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.sensors.camera_messages import camera_topics, colour_message, layer_message
from oysterbench.sensors.imu import IMU
from oysterbench.sequence.read import CALIBRATION, METADATA, OYSTERS, STEERING
from oysterbench.sequence.truth import TRANSFORMS, TRUTH, TRUTH_TYPES, truth_message
from oysterbench.sequence.write import SequenceWriter

NAMES = ("pool-01", "pool-02")
CAMERA = {
    "width": 64,
    "height": 48,
    "rate_hz": 2.0,
    "matrix": [[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]],
    "distortion_model": "plumb_bob",
    "distortion": [0.0, 0.0, 0.0, 0.0],
    "T_base_cam": np.eye(4).tolist(),
}
IMAGES = 3

RIG = """
name = "pool"
summary = "a small camera and an inertial unit"
truth_rate_hz = 50.0
[imu]
rate_hz = 100.0
gyro_noise_density = 1e-4
gyro_random_walk = 1e-5
gyro_turn_on = 1e-3
accel_noise_density = 1e-3
accel_random_walk = 1e-4
accel_turn_on = 1e-2
[[camera]]
name = "cam"
width = 64
height = 48
hfov_deg = 69.0
rate_hz = 2.0
layer_rate_hz = 2.0
"""

SPLIT = """
name = "{name}"
version = "1.0"
track = "{track}"
seed = 5
rig = "rig.toml"
summary = "a pool that is not there"
hidden = {hidden}
[defaults]
duration_s = 20.0
[defaults.reef]
size_m = 12.0
depth_m = 4.0
relief_rms_m = 0.05
oysters = 60
[defaults.water]
jerlov = "1C"
[defaults.light]
sun_elevation_deg = 50.0
sun_azimuth_deg = 200.0
[defaults.path]
kind = "loop"
radius_m = 1.0
speed_m_s = 0.3
ramp_s = 1.0
altitude_m = 0.9
[[sequence]]
name = "pool-01"
[[sequence]]
name = "pool-02"
"""

TASK = """
[steering]
yaw_deg = [20.0, 0.0, -20.0]
pitch_deg = [-15.0, 0.0, 15.0]
altitude_m = [0.5, 1.4]
"""
"""What a split of the track steering has besides."""


def path(number: int) -> Trajectory:
    """The truth of a sequence: a winding loop at 10 Hz, whose numbers are like no others."""
    rng = stream(20261120, b"", "pool", number)
    t = np.arange(200) / 10
    phases = rng.uniform(0, 6, 6)
    positions = np.column_stack([4 * np.cos(t / 3 + phases[0]), 3 * np.sin(t / 3 + phases[1]), -3 + 0.2 * np.sin(t)])
    positions += 0.1234567 * np.sin(np.outer(t, [1.1, 1.3, 1.7]) + phases[2:5])
    attitude = Rotation.from_euler("zyx", np.column_stack([t / 3, 0.1 * np.sin(t), 0.1 * np.cos(t + phases[5])]))
    return Trajectory(EPOCH_NS + np.round(t * 1e9).astype(np.int64), positions, attitude.as_quat())


def estimate(number: int, sigma_m: float = 0.02, case: int = 0) -> Trajectory:
    """The truth of a sequence with errors."""
    true = path(number)
    noise = stream(1, b"", "estimate", number, case).normal(0, sigma_m, true.positions.shape)
    return Trajectory(true.stamps_ns, true.positions + noise, true.quaternions)


def tum(trajectory: Trajectory, folder: Path) -> bytes:
    """As a TUM file."""
    write_tum(folder / "x.tum", trajectory)
    return (folder / "x.tum").read_bytes()


def answers(folder: Path, case: int = 0, sigma_m: float = 0.02) -> bytes:
    """A zip archive with an estimate for each sequence."""
    return zipped({f"{name}.tum": tum(estimate(k, sigma_m, case), folder) for k, name in enumerate(NAMES)})


def zipped(files: dict[str, bytes], **entry: Any) -> bytes:
    """A zip archive of files."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            for key, value in entry.items():
                setattr(info, key, value)
            archive.writestr(info, data)
    return out.getvalue()


def classes(sequence: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Classes and instances (48, 64) of an image: two oysters."""
    instances = np.zeros((48, 64), dtype=np.uint16)
    instances[10 + k : 24 + k, 8 + 3 * sequence : 24] = 7
    instances[30:40, 40:52] = 9
    return np.where(instances > 0, 2, 1).astype(np.uint8), instances


def image_names(sequence: int) -> list[str]:
    """Of a sequence, as they are to be answered."""
    return [f"{NAMES[sequence]}/cam/{EPOCH_NS + k * 500_000_000}" for k in range(IMAGES)]


def steered(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Classes (IMAGES, 2) of the expert at the images of a sequence, and the worth (IMAGES, 3, 3) of each pair."""
    worth = stream(20261121, b"", "pool", "worth", number).uniform(0, 9, (IMAGES, 3, 3))
    best = worth.reshape(IMAGES, -1).argmax(axis=1)
    return np.column_stack([best // 3, best % 3]), worth


def steering_table(number: int) -> bytes:
    """The truth of a sequence about steering, as it is attached to its file."""
    keys = [f"value_{i}_{j}" for i in range(3) for j in range(3)]
    lines = [",".join(["stamp_ns", "yaw", "pitch", "heading_rad", "pitch_rad", "depth_m", "altitude_m", *keys])]
    for k, (named, worth) in enumerate(zip(*steered(number), strict=True)):
        values = [EPOCH_NS + k * 500_000_000, *named.tolist(), 0.1, 0.0, 3.0, 0.9, *worth.ravel().tolist()]
        lines.append(",".join(map(str, values)))
    return "\n".join(lines).encode() + b"\n"


def write_sequence(file: Path, number: int, split: str, digest: str) -> None:
    """A sequence with truth and a few images, as if it had been rendered."""
    calibration = {
        "imu": {
            "rate_hz": 100.0,
            "gyro_noise_density": 1e-4,
            "gyro_random_walk": 1e-5,
            "gyro_turn_on": 1e-3,
            "accel_noise_density": 1e-3,
            "accel_random_walk": 1e-4,
            "accel_turn_on": 1e-2,
            "T_base_imu": transform(np.eye(3), [0.0, 0.0, 0.0]).tolist(),
            "gravity": 9.80665,
        },
        "cameras": {"cam": CAMERA},
    }
    cameras = camera_topics("cam", ("class", "instance", "depth"))
    about = {"sequence": NAMES[number], "split": split, "split_version": "1.0", "digest": digest}
    true = path(number)
    with open(file, "wb") as output:
        writer = SequenceWriter(output, {TF_STATIC: TRANSFORMS, "/imu": IMU, TRUTH: TRUTH_TYPES[TRUTH], **cameras})
        writer.metadata(METADATA, about)
        writer.attachment(CALIBRATION, "application/json", json.dumps(calibration).encode())
        oysters = b"id,state,height_m,x,y,z\n7,live,0.08,0.5,0.1,-3.0\n9,live,0.1,0.8,-0.2,-3.0\n"
        writer.attachment(OYSTERS, "text/csv", oysters)
        writer.attachment(STEERING, "text/csv", steering_table(number))
        for i, stamp in enumerate(true.stamps_ns.tolist()):
            pose = (true.positions[i], true.quaternions[i])
            writer.write(truth_message(stamp, *pose, np.zeros(3), np.zeros(3)))
        writer.section()
        for k in range(IMAGES):
            stamp = EPOCH_NS + k * 500_000_000
            named, numbered = classes(number, k)
            layers = {"class": named, "instance": numbered, "depth": np.full((48, 64), 1.0, dtype=np.float32)}
            writer.write(colour_message(stamp, "cam", np.full((48, 64, 3), 90, dtype=np.uint8), 95, "png"))
            for name, values in layers.items():
                writer.write(layer_message(stamp, "cam", name, values))
        writer.finish()


def lay_split(folder: Path, name: str = "pool-test", track: str = "slam", hidden: bool = True) -> tuple[Path, Path]:
    """Recipe and truth of a split."""
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import digest

    truth = folder / f"{name}-truth"
    truth.mkdir(parents=True)
    (folder / "rig.toml").write_text(RIG)
    recipe = folder / f"{name}.toml"
    text = SPLIT.format(name=name, track=track, hidden=str(hidden).lower())
    recipe.write_text(text + (TASK if track == "steering" else ""))
    made_by = digest(load_split(str(recipe)))
    for k, sequence in enumerate(NAMES):
        write_sequence(truth / f"{sequence}.mcap", k, name, made_by)
    return recipe, truth
