"""What another program is given of a sequence: an exported folder, or a sequence file, without the truth.

python -m oysterbench.methods.inputs SEQUENCE FORM OUT
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError, OysterbenchError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import read_times
from oysterbench.sequence import Sequence, open_sequence

FORMS = {
    "euroc": "an EuRoC folder: mav0/ with cam0, cam1, ..., imu0",
    "tum": "a TUM RGB-D folder: rgb/, rgb.txt, accelerometer.txt, calibration.txt",
    "kitti": "a KITTI odometry folder: sequences/00/ with undistorted images, calib.txt, times.txt",
    "mcap": "a sequence file with everything that was measured",
}
"""Placeholder of a command line -> what is put in its place."""

SENSORS = "sensors"
"""Form of what a method of Python is given: a sequence as it was, file or folder, without the truth."""

POSES_OF = {"euroc": "imu", "tum": "camera", "kitti": "camera", "mcap": "base"}
"""Whose poses the programs that read a form are taken to answer with: its body frame."""


def write_input(path: Path, form: str, out: Path) -> None:
    """Write the sequence at `path` in a form, without the truth; `out` is there whole or not at all."""
    if form == SENSORS and path.is_dir():
        _link_measurements(path, out)
        return
    if form in ("mcap", SENSORS):
        _write_measurements(path, out)
        return
    from oysterbench.sequence.export import export_sequence

    export_sequence(open_sequence(path).for_method(), form, out, truth=False)


def _write_measurements(path: Path, out: Path) -> None:
    """Topics and attachments that are listed as public, as a hidden split is published."""
    if not path.is_file():
        raise MethodError(f"{path}: {{mcap}} needs a sequence file, and this is a folder; {{euroc}} takes both")
    from oysterbench.sequence.cut import cut_public

    handle, temporary = tempfile.mkstemp(dir=out.parent, prefix=f".{out.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            cut_public(path, file)
        os.chmod(temporary, 0o644)
        os.replace(temporary, out)
    except BaseException:
        os.unlink(temporary)
        raise


def _link_measurements(path: Path, out: Path) -> None:
    """The cameras and the inertial unit of an EuRoC folder: files of their own names, copied only between disks."""
    temporary = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
    try:
        for sensor in [*sorted((path / "mav0").glob("cam[0-9]")), path / "mav0" / "imu0"]:
            shutil.copytree(sensor, temporary / "mav0" / sensor.name, copy_function=_link)
        temporary.chmod(0o755)
        os.replace(temporary, out)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _link(source: str, target: str) -> None:
    try:
        os.link(os.path.realpath(source), target)
    except OSError:  # another disk, or one without links
        shutil.copy(source, target)


def frame_pose(sequence: Sequence, frame: str, form: str) -> Array:
    """T_base_frame (4, 4) of `base`, `imu`, `camera` (whose images the form has first) or a camera by its name."""
    if frame == "base":
        return np.eye(4)
    if frame == "imu":
        return sequence.imu_calibration.T_base_imu
    name = first_camera(sequence, form) if frame == "camera" else frame
    if name not in sequence.cameras:
        raise MethodError(
            f"--poses-of {frame}: sequence {sequence.name} has no such frame; expected base, imu, camera or one of its "
            f"cameras: {', '.join(sequence.cameras) or 'none'}"
        )
    return sequence.cameras[name].T_base_cam


def first_camera(sequence: Sequence, form: str) -> str:
    """Name of the camera whose images a form has first; empty where there is none. KITTI begins with a left one."""
    names = list(sequence.cameras)
    if form == "kitti":
        from oysterbench.sequence.export.parts import stereo_partner

        names.sort(key=lambda name: stereo_partner(sequence, name) is None)
    return next(iter(names), "")


def kitti_stamps(sequence: Sequence, folder: Path) -> NDArray[np.int64]:
    """(N,) ns, stamps of the images of a KITTI folder, whose times.txt counts from the first of them."""
    from oysterbench.sequence.export.parts import stereo_partner

    left = first_camera(sequence, "kitti")
    right = stereo_partner(sequence, left)
    partners = None if right is None else {image.stamp_ns for image in sequence.images(right)}
    first = next(image.stamp_ns for image in sequence.images(left) if partners is None or image.stamp_ns in partners)
    return first + read_times(folder / "sequences" / "00" / "times.txt")


if __name__ == "__main__":
    try:
        write_input(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))
    except OysterbenchError as error:
        sys.exit(str(error))
