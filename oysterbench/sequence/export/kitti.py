"""KITTI odometry folders: sequences/00/ with images, calib.txt and times.txt, and poses/00.txt.

KITTI's images are rectified, so images are undistorted here, and those of a pair brought into one plane, using the
given calibration. image_0 and image_1 are grey. Poses take rectified cam 0 into the first cam 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array, invert, transform
from oysterbench.core.names import listed
from oysterbench.sequence.export.parts import (
    PAIR_RAD,
    any_camera,
    port_notes,
    rectify,
    sensor_poses,
    stereo_partner,
    undistorting_maps,
    unpaired,
    within,
    write_lines,
    write_png,
)
from oysterbench.sequence.export.port import seen_from
from oysterbench.sequence.export.readme import README, head, shutter_lines, truth_line
from oysterbench.sequence.export.steps import Steps, frames
from oysterbench.sequence.types import Sequence


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write the first stereo pair, or else the first camera alone."""
    names = list(sequence.cameras)
    left = next((name for name in names if stereo_partner(sequence, name)), None) or any_camera(sequence, "kitti")
    right = stereo_partner(sequence, left)
    pair = [left] if right is None else [left, right]
    matrix, turns = sequence.cameras[left].matrix, rectify(sequence, pair)
    place = folder / "sequences" / "00"
    place.mkdir(parents=True)
    steps.expect(2 * frames(sequence, pair))  # once for their stamps, once to be written
    stamps = [{image.stamp_ns for image in steps.counted(sequence.images(name))} for name in pair]
    kept = sorted(set.intersection(*stamps))
    notes = [f"image_{index} is {name}" for index, name in enumerate(pair)]
    faults = {name: unpaired(sequence.cameras[left], sequence.cameras[name]) for name in names if name not in pair}
    notes += [*left_out(names, pair, faults), *port_notes(sequence, pair)]
    if truth:
        path, true = sequence.truth(), sequence.truly_calibrated().cameras[left]
        times = {stamp: true.taken_ns(stamp) for stamp in kept}
        spanned = set(within(path, times.values()))
        known = [stamp for stamp in kept if times[stamp] in spanned]
        if len(known) < len(kept):
            notes.append(f"{len(kept) - len(known)} frames before or after the truth were left out: no pose is known")
        kept = known
    if not kept:
        raise SequenceError(
            f"{sequence.name}: no frame that every camera and the ground truth share; nothing to export"
        )
    for index, name in enumerate(pair):
        _write_images(sequence, name, matrix, turns[index], kept, place / f"image_{index}", steps)
    calibration = [*_projections(sequence, pair, matrix), f"Tr: {_row(_of_body(sequence, left, turns[0]))}"]
    write_lines(place / "calib.txt", calibration)
    write_lines(place / "times.txt", (f"{(stamp - kept[0]) * 1e-9:.9e}" for stamp in kept))
    write_lines(
        folder / README, [head(sequence, "KITTI odometry"), "", *_about(sequence, pair, matrix, kept[0], truth)]
    )
    if truth:
        taken = np.array([times[stamp] for stamp in kept], dtype=np.int64)
        poses = sensor_poses(
            path.at(taken), seen_from(sequence.cameras[left], true) @ transform(turns[0].T, np.zeros(3))
        )
        (folder / "poses").mkdir()
        write_lines(folder / "poses" / "00.txt", (_row(pose[:3]) for pose in invert(poses[0]) @ poses))
    return notes


def left_out(names: Iterable[str], pair: list[str], faults: Mapping[str, str] = MappingProxyType({})) -> list[str]:
    """Say which cameras are not exported, and why. faults: what keeps each from being the right one, as `unpaired`."""
    others = [name for name in names if name not in pair]
    if not others:
        return []
    limit = f"{np.rad2deg(PAIR_RAD):.0f} deg"
    pairs = f"the layout has one pair, of cameras of one size, parallel to {limit} and side by side to {limit}"
    if len(pair) > 1:
        return [f"left out: {listed(others)}: {pairs}, and {pair[0]} and {pair[1]} are that pair"]
    seen = "".join(f"; {name} is {fault}" for name, fault in faults.items())
    return [f"left out: {listed(others)}: {pairs}{seen}; {pair[0]} has none such to its right"]


def _about(sequence: Sequence, pair: list[str], matrix: Array, first_ns: int, truth: bool) -> list[str]:
    """Lines of README.txt."""
    left = sequence.cameras[pair[0]]
    lines = [f"image_{index}: {name}, grey, {left.rate_hz:g} Hz" for index, name in enumerate(pair)]
    if len(pair) > 1:
        right = [float(value) for value in _projections(sequence, pair, matrix)[1].split()[1:]]
        lines.append(f"The right camera is {-right[3] / right[0]:.6f} m to the right (P1: -fx times that).")
    return [
        *lines,
        "calib.txt: P0 to P3 project from image_0's frame; Tr takes points of base_link into it, as there is no laser.",
        "The images were undistorted, and those of a pair rectified: they have no distortion left.",
        *(f"{name}, as taken: {line}" for name in pair for line in shutter_lines(sequence.cameras[name])),
        f"times.txt is in s from the first image, whose stamp is {first_ns} ns; the layout has no IMU.",
        truth_line(truth, "poses/00.txt, of the camera of image_0"),
    ]


def _projections(sequence: Sequence, pair: list[str], matrix: Array) -> list[str]:
    """Lines of calib.txt: projections (3, 4) from the frame of image_0. Always four, as readers expect: those of the
    colour cameras repeat the grey ones, and for a camera alone so do those of the right cameras."""
    T_base_left = sequence.cameras[pair[0]].T_base_cam
    rows = []
    for name, turn in zip(pair, rectify(sequence, pair), strict=True):
        T_left_cam = invert(T_base_left) @ sequence.cameras[name].T_base_cam
        offset = turn @ T_left_cam[:3, :3].T @ T_left_cam[:3, 3]
        rows.append(_row(matrix @ np.column_stack([np.eye(3), -offset])))
    return [f"P{index}: {row}" for index, row in enumerate(rows * (4 // len(rows)))]


def _of_body(sequence: Sequence, left: str, turn: Array) -> Array:
    """Tr (3, 4) of calib.txt: in KITTI from the laser scanner into image_0, here from base_link, whose axes are the
    same: x forward, y left, z up. Common loaders, such as pykitti, do not open a folder without it."""
    return (transform(turn, np.zeros(3)) @ invert(sequence.cameras[left].T_base_cam))[:3]


def _write_images(
    sequence: Sequence, name: str, matrix: Array, turn: Array, kept: list[int], folder: Path, steps: Steps
) -> None:
    """Write the images of the stamps `kept`, numbered as these are; of several at one stamp, the first."""
    folder.mkdir()
    maps = undistorting_maps(sequence.cameras[name], matrix, turn)
    numbers = {stamp: index for index, stamp in enumerate(kept)}
    for image in steps.counted(sequence.images(name)):
        index = numbers.pop(image.stamp_ns, None)
        if index is None:
            continue
        pixels = image.pixels if maps is None else np.asarray(cv2.remap(image.pixels, *maps, cv2.INTER_LINEAR))
        write_png(folder / f"{index:06d}.png", cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))


def _row(matrix: Array) -> str:
    return " ".join(f"{value:.12e}" for value in np.ravel(matrix))
