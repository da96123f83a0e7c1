"""Shared parts of several formats: images on disk, matrices as YAML, poses of sensors, and stereo pairs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array, invert
from oysterbench.core.measurements import Image, ImuMeasurement
from oysterbench.core.trajectory import Trajectory
from oysterbench.sequence.pictures import png_bytes
from oysterbench.sequence.types import CameraCalibration, Sequence

UNTURNED = np.eye(3)
PAIR_RAD = np.radians(3.0)  # limit on the rotation between a stereo pair's cameras, and between baseline and x axis


def write_png(path: Path, pixels: NDArray[Any]) -> None:
    """Write (H, W, 3) uint8 RGB, or (H, W) uint8 or uint16, as PNG."""
    path.write_bytes(png_bytes(pixels))


def number(value: float) -> str:
    """Format a number for YAML 1.1 with all its digits: there `1e-05` is a string, and `1.0e-05` a number."""
    text = repr(float(value))
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def numbers(values: ArrayLike) -> str:
    """Format numbers as a YAML list."""
    return "[" + ", ".join(number(value) for value in np.ravel(values)) + "]"


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a text file of lines."""
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for line in lines)


def inertial_samples(sequence: Sequence) -> Iterator[ImuMeasurement]:
    """Inertial measurements; none where a file has other topics of its split only."""
    return sequence.imu() if sequence.has_imu else iter(())


def labelled_cameras(sequence: Sequence, *further: str) -> dict[str, list[str]]:
    """Cameras with the layers class and instance -> which of these and of `further` each has, in this order."""
    topics = {topic for topic, _, _ in sequence.contents()}
    found = {}
    for camera in sequence.cameras:
        layers = [name for name in ("class", "instance", *further) if f"/{camera}/{name}" in topics]
        if layers[:2] == ["class", "instance"]:
            found[camera] = layers
    return found


def frames_with_layers(
    sequence: Sequence, camera: str, layers: Iterable[str]
) -> Iterator[tuple[Image, dict[str, NDArray[Any]]]]:
    """Yield the colour frames of a camera that have layers, with the pixels of each layer by its name.

    Raises SequenceError where the stamps of layers and frames differ.
    """
    names = list(layers)
    images = sequence.images(camera)
    for found in zip_longest(*(sequence.layer(camera, name) for name in names)):
        stamps = {None if layer is None else layer.stamp_ns for layer in found}
        image = next((image for image in images if image.stamp_ns in stamps), None)
        if image is None or len(stamps) > 1:
            raise SequenceError(f"{sequence.name}: layers of {camera} without their frame, or one without the others")
        yield image, {name: layer.pixels for name, layer in zip(names, found, strict=True)}


def sensor_poses(truth: Trajectory, T_base_sensor: Array) -> Array:
    """(N, 4, 4) T_map_sensor at the stamps of a trajectory of base_link."""
    return np.asarray(truth.matrices @ T_base_sensor)


def within(truth: Trajectory, stamps_ns: Iterable[int]) -> list[int]:
    """Stamps within the time span of the ground truth."""
    first, last = int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    return [stamp for stamp in stamps_ns if first <= stamp <= last]


def stereo_partner(sequence: Sequence, camera: str) -> str | None:
    """Camera that forms a stereo pair with `camera` once both are rectified: of the same size, to its right along its x
    axis, and rotated relative to it by no more than a calibration may find; None if there is none."""
    left = sequence.cameras[camera]
    others = (name for name in sequence.cameras if name != camera)
    return next((name for name in others if not unpaired(left, sequence.cameras[name])), None)


def unpaired(left: CameraCalibration, right: CameraCalibration) -> str:
    """What keeps two cameras from being a stereo pair, as said of the right one; empty where they are one."""
    T_left_right = invert(left.T_base_cam) @ right.T_base_cam
    turn = scipy.spatial.transform.Rotation.from_matrix(T_left_right[:3, :3]).magnitude()
    across, aside = float(T_left_right[0, 3]), float(np.hypot(*T_left_right[1:3, 3]))
    if (left.width, left.height) != (right.width, right.height):
        return "of another size"
    if turn >= PAIR_RAD:
        return f"turned by {np.degrees(turn):.1f} deg"
    if across <= 1e-3:
        return "not to its right"
    return f"{np.degrees(np.arctan2(aside, across)):.1f} deg off its x axis" if aside >= PAIR_RAD * across else ""


def rectify(sequence: Sequence, pair: Iterable[str]) -> list[Array]:
    """Rotations (3, 3) that take the frames of a left and a right camera into those of a rectified pair, whose x axis
    lies along the baseline; identities for a camera alone, or a pair that is already rectified."""
    left, *others = (sequence.cameras[name].T_base_cam for name in pair)
    turns = [invert(left)[:3, :3] @ right[:3, :3] for right in others]
    offsets = [(invert(left) @ right)[:3, 3] for right in others]
    straight = all(np.allclose(turn, np.eye(3), atol=1e-6) for turn in turns)
    if straight and all(np.allclose(offset[1:], 0.0, atol=1e-6) for offset in offsets):
        return [np.eye(3), *(np.eye(3) for _ in others)]
    x = offsets[0] / np.linalg.norm(offsets[0])
    y = np.cross(0.5 * (turns[0][:, 2] + [0.0, 0.0, 1.0]), x)
    y /= np.linalg.norm(y)
    into = np.array([x, y, np.cross(x, y)])
    return [into, into @ turns[0]]


def undistorting_maps(camera: CameraCalibration, matrix: Array, turn: Array = UNTURNED) -> tuple[Any, Any] | None:
    """Maps (H, W) float32 for cv2.remap that undistort a camera's image to that of a pinhole in the frame into which
    `turn` (3, 3) takes the camera's own; None where nothing would change."""
    pinhole = camera.distortion_model == "plumb_bob" and not np.any(camera.distortion)
    if pinhole and np.allclose(camera.matrix, matrix) and np.array_equal(turn, UNTURNED):
        return None
    size = (camera.width, camera.height)
    if camera.distortion_model == "equidistant":
        return cv2.fisheye.initUndistortRectifyMap(
            camera.matrix, camera.distortion[:4], turn, matrix, size, cv2.CV_32FC1
        )
    return cv2.initUndistortRectifyMap(camera.matrix, camera.distortion, turn, matrix, size, cv2.CV_32FC1)


def any_camera(sequence: Sequence, form: str) -> str:
    """Name of the first camera. Raises SequenceError where there is none."""
    for name in sequence.cameras:
        return name
    raise SequenceError(f"{sequence.name} has no camera; the format {form} needs one")


def port_notes(sequence: Sequence, cameras: Iterable[str]) -> list[str]:
    """Notes on cameras behind a flat port, for formats that only support pinholes and lenses."""
    return [
        f"{name} looks through a flat port: its calibration is that in air, as the format cannot say how water bends it"
        for name in cameras
        if sequence.cameras[name].port_m is not None
    ]
