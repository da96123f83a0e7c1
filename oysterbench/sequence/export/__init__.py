"""Sequences in the formats of others, a file per format: `export_sequence` writes one as a folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from oysterbench.core.errors import SequenceError
from oysterbench.sequence.types import Sequence

FORMATS = {
    "euroc": "EuRoC/ASL: mav0/ with PNG images, IMU, sensor.yaml files and the state; for visual-inertial SLAM",
    "tum": "TUM RGB-D: rgb/ and depth/ with lists, groundtruth.txt, accelerometer.txt",
    "kitti": "KITTI odometry: undistorted image_0/ (image_1/ of a stereo pair), calib.txt, times.txt, poses of image_0",
    "coco": "COCO instances: images and instances.json with polygons",
    "kalibr": "Kalibr calibration: camchain-imucam.yaml and imu.yaml",
    "ply": "point clouds in map as binary PLY: of depth images through the poses, and of sonar clouds",
}
"""Formats and what they are; a format is the module of its name, with `write(sequence, folder, truth)`."""

Write = Callable[[Sequence, Path, bool], list[str]]
"""Fills a folder, and returns what the user should know about it, a line each."""


def export_sequence(
    sequence: Sequence, form: str, out: str | os.PathLike[str], truth: bool = True
) -> tuple[Path, list[str]]:
    """Write a sequence in a format (`FORMATS`) as the folder `out`, which is there whole or not at all.

    truth: with poses, depth, classes and instances where the format has a place for them; without, only what a method
    may see. Returns the folder and what there is to say about it. Raises SequenceError where `out` is there already,
    or the sequence lacks what the format needs.
    """
    if form not in FORMATS:
        raise SequenceError(f"unknown format {form!r}; formats: {', '.join(FORMATS)}")
    folder = Path(out)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SequenceError(f"{folder} is there already; it was left as it is: delete it or choose another --out")
    folder.parent.mkdir(parents=True, exist_ok=True)
    write: Write = import_module(f"oysterbench.sequence.export.{form}").write
    temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        temporary.chmod(0o755)
        notes = write(sequence, temporary, truth)
        temporary.replace(folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    return folder, notes
