"""TUM RGB-D folders: rgb/, depth/, their lists, the camera's path, the accelerometer, README.txt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy

from oysterbench.core.trajectory import Trajectory, ns_to_seconds, write_tum
from oysterbench.sequence.export.parts import (
    any_camera,
    inertial_samples,
    port_notes,
    sensor_poses,
    write_lines,
    write_png,
)
from oysterbench.sequence.export.port import lens_centre_m
from oysterbench.sequence.export.readme import truth_line, write_readme
from oysterbench.sequence.export.steps import Steps, frames
from oysterbench.sequence.types import CameraCalibration, Sequence

OWN = ("Stamps are in s. accelerometer.txt is of the IMU, in its frame; the layout has no place for a gyroscope.",)
DEPTH_STEPS = 5000.0
"""Depth image units per metre; the maximum, 65535, is 13.1 m."""
PLACE = f"groundtruth.txt, of the camera, and in depth/, {DEPTH_STEPS:g} to the metre"


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write one camera: the first with depth, or else the first."""
    depth_of = {topic.split("/")[1] for topic, _, _ in sequence.contents() if topic.endswith("/depth")}
    name = next((camera for camera in sequence.cameras if camera in depth_of), None) or any_camera(sequence, "tum")
    with_depth = truth and name in depth_of
    steps.expect(frames(sequence, [name]) + (frames(sequence, [name], "depth") if with_depth else 0))
    (folder / "rgb").mkdir()
    rows = _header(sequence, f"color images of {name}", "timestamp filename")
    for image in steps.counted(sequence.images(name)):
        file = f"rgb/{ns_to_seconds(image.stamp_ns)}.png"
        write_png(folder / file, image.pixels)
        rows.append(f"{ns_to_seconds(image.stamp_ns)} {file}")
    write_lines(folder / "rgb.txt", rows)
    samples = (
        " ".join([ns_to_seconds(sample.stamp_ns), *(repr(float(value)) for value in sample.accel)])
        for sample in inertial_samples(sequence)
    )
    header = _header(sequence, "accelerometer data, in the frame of the IMU", "timestamp ax ay az")
    write_lines(folder / "accelerometer.txt", [*header, *samples])
    write_lines(folder / "calibration.txt", _calibration(sequence.cameras[name]))
    own = [*OWN, *(_behind_port(sequence, name) if with_depth else ()), truth_line(truth, PLACE)]
    write_readme(sequence, folder, "TUM RGB-D", {"rgb": name}, truth, own)
    notes = [f"images of {name}"]
    notes += port_notes(sequence, [name])
    if not truth:
        return [*notes, "depth is truth here: left out"] if name in depth_of else notes
    far = _write_depth(sequence, name, folder, steps) if with_depth else 0
    if far:
        notes.append(f"{far} pixels of depth beyond {65535 / DEPTH_STEPS:g} m do not fit the format: they are 0")
    path = sequence.truth()
    poses = sensor_poses(path, sequence.truly_calibrated().cameras[name].T_base_cam)
    quaternions = scipy.spatial.transform.Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    header = _header(sequence, f"ground truth trajectory of {name}", "timestamp tx ty tz qx qy qz qw")
    write_tum(folder / "groundtruth.txt", Trajectory(path.stamps_ns, poses[:, :3, 3], quaternions), header)
    return notes


def _header(sequence: Sequence, what: str, columns: str) -> list[str]:
    """First lines of a list, three as in the data set: ORB-SLAM skips as many, whatever they hold."""
    return [f"# {what}", f"# file: {sequence.name!r}", f"# {columns}"]


def _write_depth(sequence: Sequence, name: str, folder: Path, steps: Steps) -> int:
    """Write depth images, 0 = none. Returns how many pixels are too far for the format."""
    (folder / "depth").mkdir()
    rows, far = _header(sequence, f"depth maps of {name}, {DEPTH_STEPS:g} to the metre", "timestamp filename"), 0
    for image in steps.counted(sequence.layer(name, "depth")):
        file = f"depth/{ns_to_seconds(image.stamp_ns)}.png"
        levels = np.rint(image.pixels * DEPTH_STEPS)
        far += int(np.count_nonzero(levels > 65535))
        write_png(folder / file, np.where(levels > 65535, 0, levels).astype(np.uint16))
        rows.append(f"{ns_to_seconds(image.stamp_ns)} {file}")
    write_lines(folder / "depth.txt", rows)
    return far


def _behind_port(sequence: Sequence, name: str) -> list[str]:
    """Lines of README.txt on depth behind a flat port, where the centre of the given lens is not the true pupil."""
    given, true = sequence.cameras[name], sequence.truly_calibrated().cameras[name]
    if given.port_m is not None or true.port_m is None:
        return []
    ahead_m = -lens_centre_m(true)
    return [
        f"The camera is behind a flat port. Depth and poses are those of its pupil, {1e3 * ahead_m:.2f} mm in front of",
        "the centre of the lens that calibration.txt gives: the point of a pixel is its ray (x, y, 1) there, times",
        "depth plus that distance, less that distance along z.",
    ]


def _calibration(camera: CameraCalibration) -> list[str]:
    matrix = camera.matrix
    values = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *camera.distortion]
    return [
        f"# {camera.width} x {camera.height}, {camera.distortion_model}",
        "# fx fy cx cy and the coefficients of distortion",
        " ".join(repr(float(value)) for value in values),
    ]
