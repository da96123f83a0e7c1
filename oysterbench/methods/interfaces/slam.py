"""Methods of the track SLAM: a sequence without ground truth in, poses T_odom_base out.

    python -m oysterbench.methods.interfaces.slam SEQUENCE FORM OUT

writes an input. A run leaves in its folder: estimate.npz, the path that is scored; estimate.NAME.npz for each
alternative; map.ply and keyframes.tum if there is a map; health.csv if the method says how it obtained each pose.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.disk_space import link
from oysterbench.core.errors import MethodError, OysterbenchError, TrajectoryError
from oysterbench.core.geometry import Array, transform
from oysterbench.core.helpers import module_command
from oysterbench.core.permissions import umask
from oysterbench.core.trajectory import Trajectory, read_times, read_trajectory, write_npz
from oysterbench.methods.health import HEALTH, health_notes, read_health, write_health
from oysterbench.methods.interfaces.interface import Interface, Predicted, RunSequence, Stopwatch
from oysterbench.methods.method import Estimate, check_estimate
from oysterbench.methods.processes import Processes
from oysterbench.sequence import Sequence, open_sequence
from oysterbench.sequence.state import file_digests, sensor_folders

ESTIMATE = "estimate.npz"
ONLINE = "trajectory.online.tum"
EXPORT_LIMIT_S = 24 * 3600.0
SAME_NS = 1_000_000
"""Difference up to which a pose's stamp is that of an image, ns: programs print milliseconds at least."""

FORMS = {
    "euroc": "an EuRoC folder: mav0/ with cam0, cam1, ..., imu0",
    "tum": "a TUM RGB-D folder: rgb/, rgb.txt, accelerometer.txt, calibration.txt",
    "kitti": "a KITTI odometry folder: sequences/00/ with undistorted grey images, calib.txt, times.txt",
    "rosbag": "a folder with a ROS 1 bag, NAME.bag, like EuRoC's: /cam0/image_raw, /imu0; and Kalibr's files",
    "mcap": "a sequence file with everything that was measured",
}
"""Placeholder of a command line -> description of what replaces it."""

SENSORS = "sensors"
"""Input form of Python methods: the sequence as it is, file or folder, without the ground truth."""

POSES_OF = {"euroc": "imu", "tum": "camera", "kitti": "camera", "rosbag": "imu", "mcap": "base"}
"""Form -> frame whose poses a program that reads it is assumed to write."""


class SequencePath(RunSequence):
    """A sequence given by its file, or by its folder in EuRoC layout."""

    def __init__(self, name: str, path: Path) -> None:
        self.name, self.path = name, path

    @property
    def origin(self) -> str:
        """Path of the file or folder, and on further lines the digests and names of what it holds, which are looked at
        once."""
        return "\n".join((str(self.path.resolve()), *(f"{digest} {name}" for name, digest in self._digests.items())))

    @cached_property
    def _digests(self) -> dict[str, str]:
        return file_digests(self.path)

    def __getstate__(self) -> dict[str, Any]:
        # Another process, perhaps on another machine, looks at the files that are there.
        return {key: value for key, value in vars(self).items() if key != "_digests"}

    @property
    def source(self) -> Path | None:
        """The file or folder itself, unless a split made it."""
        return self.path if self.split is None else None

    @property
    def hidden(self) -> tuple[Path, ...]:
        """The file or folder itself."""
        return (self.path,)

    @cached_property
    def limit_s(self) -> float:
        """Ten times the sequence's duration, but at least ten minutes."""
        return max(10 * open_sequence(self.path).duration_s, 600.0)

    def write_input(self, form: str, out: Path, processes: Processes) -> None:
        """Write the input in a separate process, which can be stopped at any time."""
        words = module_command(__name__, self.path.absolute(), form, out.absolute())
        ended = processes.run(words, EXPORT_LIMIT_S, out.parent)
        if ended.failure is not None:
            raise MethodError(ended.failure)


class SlamInterface(Interface):
    """A sequence in, an `Estimate` out."""

    forms = FORMS
    own_form = SENSORS
    lasting = ("euroc", "tum", "kitti", "rosbag")
    out = "trajectory.tum"
    leaves = "a trajectory"
    further: ClassVar[Mapping[str, str]] = {"online": ONLINE}

    def input_name(self, sequence: RunSequence, form: str) -> str:
        """Return the name of the input, with the suffix .mcap if it is a file."""
        assert isinstance(sequence, SequencePath)
        is_file = form == "mcap" or (form == SENSORS and sequence.path.is_file())
        return f"{sequence.name}.mcap" if is_file else sequence.name

    def options_of(self, form: str, poses_of: str = "") -> dict[str, str]:
        """Return the frame whose poses a program writes, as `poses_of`."""
        return {"poses_of": poses_of or POSES_OF[form]}

    def check(self, sequence: RunSequence, form: str, options: Mapping[str, str]) -> None:
        """Check that the sequence can be given in the form, and has the frame whose poses the program writes."""
        assert isinstance(sequence, SequencePath)
        if form == "mcap" and sequence.path.is_dir():
            raise MethodError(
                f"{sequence.path}: {{mcap}} needs a sequence file, and this is a folder; {{euroc}} takes both"
            )
        whole = options["poses_of"] in ("base", "imu")
        if whole and form not in ("tum", "kitti"):
            return
        try:
            opened = open_sequence(sequence.path)
        except OysterbenchError:  # the run itself will report it
            return
        if whole:
            if not opened.cameras:
                raise MethodError(f"{sequence.name} has no camera; the form {{{form}}} needs one")
            return
        frame_pose(opened, options["poses_of"], form)

    def predict(self, method: Any, given: Path, folder: Path, watch: Stopwatch) -> Predicted:
        """Run the method on a sequence from which the ground truth was removed."""
        sequence = open_sequence(given).for_method()
        with watch:
            estimate = method.run(sequence)
        return keep(check_estimate(estimate, method.name, given.stem), folder)

    def take(
        self, sequence: RunSequence, given: Path, folder: Path, form: str, options: Mapping[str, str]
    ) -> Predicted:
        """Read the poses, of the frame `poses_of` (by default that of the form), and convert them to poses of the body.

        An online path, with each pose as it was known at its time, becomes the alternative "online"; if it cannot be
        read, a note says so.
        """
        assert isinstance(sequence, SequencePath)
        opened = open_sequence(sequence.path)
        T_base_frame = frame_pose(opened, options["poses_of"], form)
        times = kitti_stamps(opened, given) if form == "kitti" else None
        try:
            found = _read_path(folder / self.out, T_base_frame, times)
        except TrajectoryError as error:
            raise MethodError(f"wrote no readable trajectory: {_in_a_run(error, 'program')}") from None
        estimate = Estimate(found)
        if (folder / ONLINE).exists():
            try:
                path = _read_path(folder / ONLINE, T_base_frame, times)
                estimate = Estimate(found, scored="final", alternatives={"online": path})
            except (TrajectoryError, MethodError) as error:
                note = f"its online path cannot be read and was left out: {_in_a_run(error, 'program')}"
                estimate = Estimate(replace(found, notes=(*found.notes, note)))
        return keep(estimate, folder)


def _read_path(file: Path, T_base_frame: Array, times: NDArray[np.int64] | None) -> Trajectory:
    """Read poses of a frame and return those of the body. times: (N,) ns, of KITTI's images. Raises TrajectoryError."""
    found = read_trajectory(file, T_body_estimate=T_base_frame, times=times)
    return found if times is None else on_clock(found, times)


def on_clock(path: Trajectory, times: NDArray[np.int64]) -> Trajectory:
    """Return a path whose stamps may count from the first image, as in KITTI's times.txt, with the sequence's stamps.

    times: (N,) ns, stamps of the images. The stamps count from the first image if they end before it, or else if more
    of them fit the images when counted so. Where as many do either way, they are taken as they are, which is noted.
    """
    if not len(path) or times[0] == 0:
        return path
    relative, absolute = _fit(path.stamps_ns, times - times[0]), _fit(path.stamps_ns, times)
    if path.stamps_ns[-1] < times[0] or relative > absolute:
        note = "its timestamps count from the first image, as in times.txt: that image's timestamp was added"
        return replace(path, stamps_ns=path.stamps_ns + times[0], notes=(*path.notes, note))
    if relative == absolute > (0, 0):
        note = (
            "its timestamps may count from the first image, as in times.txt, or be the sequence's, and are taken as the"
            " sequence's: with a pose for the first image, or 12 columns for each, there is no doubt"
        )
        return replace(path, notes=(*path.notes, note))
    return path


def _fit(stamps_ns: NDArray[np.int64], times: NDArray[np.int64]) -> tuple[int, int]:
    """Number of stamps (N,) within the time of the images (M,), and of those that are an image's; all in ns."""
    after = np.clip(np.searchsorted(times, stamps_ns), 1, max(len(times) - 1, 1))
    near = np.minimum(abs(stamps_ns - times[after - 1]), abs(stamps_ns - times[np.minimum(after, len(times) - 1)]))
    within = (stamps_ns >= times[0] - SAME_NS) & (stamps_ns <= times[-1] + SAME_NS)
    return int(np.count_nonzero(within)), int(np.count_nonzero(near <= SAME_NS))


def _in_a_run(error: Exception, whose: str) -> str:
    """What is wrong with a path, without the options of `eval`, which runs do not have."""
    plain, options = re.subn(r" \([^()]*--[^()]*\)", "", str(error))
    return f"{plain}; the {whose} itself has to do so" if options else plain


def keep(estimate: Estimate, folder: Path) -> Predicted:
    """Write an estimate into a folder."""
    write_npz(folder / ESTIMATE, estimate.trajectory)
    for name, path in estimate.alternatives.items():
        write_npz(folder / alternative_file(name), path)
    counts = None
    if estimate.map is not None:
        estimate.map.write(folder)
        counts = {"keyframes": len(estimate.map.keyframes), "landmarks": len(estimate.map.landmarks)}
    if estimate.health is not None:
        write_health(folder / HEALTH, estimate.trajectory.stamps_ns, estimate.health)
    found = described(estimate.scored, estimate.alternatives, counts, estimate.health is not None)
    notes = health_notes(estimate.info, estimate.trajectory.stamps_ns, estimate.health)
    return Predicted(estimate.info, found, notes=[*estimate.trajectory.notes, *notes])


def described(
    scored: str, alternatives: Mapping[str, Trajectory], counts: Mapping[str, int] | None, health: bool
) -> dict[str, Any]:
    """Description of an estimate, as kept in its record.

    scored: the method's name for the path that is scored; alternatives: names of the others; map: numbers of keyframes
    and landmarks of the map, None if there is none; health: whether the method says how it obtained each pose
    """
    return {"scored": scored, "alternatives": list(alternatives), "map": counts, "health": health}


def alternative_file(name: str) -> str:
    """Name of an alternative's file in the folder of its run."""
    return f"estimate.{name}.npz"


def read_estimate(folder: Path) -> Trajectory:
    """Read the poses T_odom_base of a run that did not fail. Raises MethodError where the file is not a trajectory."""
    return _read_npz(folder / ESTIMATE)


def read_alternatives(folder: Path, prediction: Mapping[str, Any]) -> dict[str, Trajectory]:
    """Read the alternative paths of a run, by name."""
    return {name: _read_npz(folder / alternative_file(name)) for name in prediction["alternatives"]}


def read_run_health(folder: Path, prediction: Mapping[str, Any]) -> tuple[NDArray[np.int64], NDArray[np.uint8]] | None:
    """Read the stamps (N,) of a run's poses and the `Health` (N,) of each; None if the method gave no health."""
    return read_health(folder / HEALTH) if prediction.get("health") else None


def _read_npz(path: Path) -> Trajectory:
    try:
        return read_trajectory(path)
    except TrajectoryError as error:
        raise MethodError(f"wrote no readable trajectory: {_in_a_run(error, 'method')}") from None


def write_input(path: Path, form: str, out: Path) -> None:
    """Write the sequence at `path` in a form, without the ground truth; `out` ends up complete or not there at all."""
    if form == SENSORS and path.is_dir():
        _link_measurements(path, out)
        return
    if form in ("mcap", SENSORS):
        _write_measurements(path, out)
        return
    from oysterbench.sequence.export import export_sequence

    export_sequence(open_sequence(path).for_method(), form, out, truth=False)


def _write_measurements(path: Path, out: Path) -> None:
    """Copy only the topics and attachments listed as public, as in the published file of a hidden split."""
    if not path.is_file():
        raise MethodError(f"{path}: {{mcap}} needs a sequence file, and this is a folder; {{euroc}} takes both")
    from oysterbench.sequence.cut import cut_public

    handle, temporary = tempfile.mkstemp(dir=out.parent, prefix=f".{out.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            cut_public(path, file)
        os.chmod(temporary, 0o666 & ~umask())
        os.replace(temporary, out)
    except BaseException:
        os.unlink(temporary)
        raise


def _link_measurements(path: Path, out: Path) -> None:
    """Hard-link the cameras and the IMU of an EuRoC folder; files are copied only if `out` is on another disk."""
    temporary = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
    try:
        for sensor in sensor_folders(path):
            place = temporary / "mav0" / sensor.name
            # Where a link leads nowhere, the file is missing, and whoever reads it is told so.
            shutil.copytree(sensor, place, copy_function=link, ignore_dangling_symlinks=True)
        temporary.chmod(0o777 & ~umask())
        os.replace(temporary, out)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def frame_pose(sequence: Sequence, frame: str, form: str) -> Array:
    """T_base_frame (4, 4) of `base`, `imu`, `camera` (the first camera of the form) or a camera given by name."""
    if frame == "base":
        return np.eye(4)
    if frame == "imu":
        return sequence.imu_calibration.T_base_imu
    name = first_camera(sequence, form) if frame == "camera" else frame
    if not name:
        raise MethodError(
            f"sequence {sequence.name} has no camera, whose poses a program that reads {{{form}}} is taken to write: "
            "give it a camera, or say whose poses they are with --poses-of base or imu"
        )
    if name not in sequence.cameras:
        raise MethodError(
            f"--poses-of {frame}: sequence {sequence.name} has no such frame; expected base, imu, camera or one of its "
            f"cameras: {', '.join(sequence.cameras) or 'none'}"
        )
    T_base_cam = sequence.cameras[name].T_base_cam
    if form != "kitti" or frame != "camera":
        return T_base_cam
    from oysterbench.sequence.export.parts import rectify, stereo_partner

    right = stereo_partner(sequence, name)
    turn, *_ = rectify(sequence, [name] if right is None else [name, right])
    return T_base_cam @ transform(turn.T, np.zeros(3))


def first_camera(sequence: Sequence, form: str) -> str:
    """Name of the first camera of a form; empty if there is none. In KITTI, the left camera of a pair comes first."""
    names = list(sequence.cameras)
    if form == "kitti":
        from oysterbench.sequence.export.parts import stereo_partner

        names.sort(key=lambda name: stereo_partner(sequence, name) is None)
    return next(iter(names), "")


def kitti_stamps(sequence: Sequence, folder: Path) -> NDArray[np.int64]:
    """Stamps (N,) ns of the images of a KITTI folder, whose times.txt counts from the first image."""
    from oysterbench.sequence.export.parts import stereo_partner

    left = first_camera(sequence, "kitti")
    right = stereo_partner(sequence, left)
    partners = None if right is None else {image.stamp_ns for image in sequence.images(right)}
    first = next(image.stamp_ns for image in sequence.images(left) if partners is None or image.stamp_ns in partners)
    return first + read_times(folder / "sequences" / "00" / "times.txt")


INTERFACE = SlamInterface()

if __name__ == "__main__":
    try:
        write_input(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))
    except OysterbenchError as error:
        sys.exit(str(error))
