"""Export of sequences to other formats, one module per format: `export_sequence` writes one as a folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

from oysterbench.core.atomic import appearing_folder
from oysterbench.core.disk_space import SpaceCheck
from oysterbench.core.errors import SequenceError
from oysterbench.sensors.registry import export_formats
from oysterbench.sequence.export.steps import Progress, Steps
from oysterbench.sequence.types import Sequence

SHARED_FORMATS = {
    "euroc": "EuRoC/ASL: mav0/ with PNG images, IMU, sensor.yaml files, ground-truth states; for visual-inertial SLAM",
    "tum": "TUM RGB-D: rgb/ and depth/ with lists, groundtruth.txt, accelerometer.txt",
    "kitti": "KITTI odometry: undistorted grey image_0/, image_1/ of a pair, calib.txt, times.txt, poses of image_0",
    "coco": "COCO instances: images and instances.json with polygons",
    "kalibr": "Kalibr calibration: camchain-imucam.yaml and imu.yaml",
    "rosbag": "ROS 1 bag with EuRoC's topics: /cam0/image_raw (mono8), /imu0; and Kalibr's files",
    "mcap": "the sequence file itself, for ROS 2 Jazzy and later; with --no-truth, only the measurements",
    "foxglove": "the same, plus a layout that opens it in Foxglove or Lichtblick: cameras, sonars, path, plots",
    "ply": "point clouds in map as binary PLY: from depth images through the poses, and sonar clouds",
}
"""Formats for several sensors -> description. Each is written by `write` of the module of its name."""

FORMATS = SHARED_FORMATS | {form: export.summary for form, (_, export) in export_formats().items()}
"""All formats -> description, including those of single kinds of sensor (`SensorKind.exports`)."""

Write = Callable[[Sequence, Path, bool, Steps], list[str]]
"""Function that fills a folder, counting what it writes, and returns notes for the user, a line each."""


def export_sequence(
    sequence: Sequence,
    form: str,
    out: str | os.PathLike[str],
    truth: bool = True,
    progress: Progress = lambda done, total: None,
) -> tuple[Path, list[str]]:
    """Write a sequence in a format (`FORMATS`) as the folder `out`, which appears complete or not at all.

    truth: with poses, depth, classes and instances where the format has a place for them; without, only what a method
    may see. progress: called for each image written. Returns the folder and notes for the user. Raises SequenceError
    where `out` already exists, or the sequence lacks what the format needs, and MachineError where it will not fit on
    the disk.
    """
    if form not in FORMATS:
        raise SequenceError(f"unknown format {form!r}; formats: {', '.join(FORMATS)}")
    folder = Path(out)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SequenceError(f"{folder} already exists and was left unchanged: delete it or choose another --out")
    write: Write = import_module(f"{__name__}.{form}").write if form in SHARED_FORMATS else partial(_write_kind, form)
    with appearing_folder(folder) as draft:
        notes = write(sequence, draft, truth, Steps(progress, SpaceCheck(draft, folder)))
    return folder, notes


def _write_kind(form: str, sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write every sensor of the kind that a format is for."""
    kind, export = export_formats()[form]
    names = sequence.calibrations(kind)
    if not names:
        raise SequenceError(f"{sequence.name} has no {kind.title}; the format {form} needs one")
    steps.expect(len(names))
    return [note for name in steps.counted(names) for note in export.write(sequence, name, folder, truth)]
