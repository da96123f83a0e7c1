"""Options of the SLAM track: how estimate and ground truth are matched, and how files of poses are read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.tracks.track import Option

if TYPE_CHECKING:
    from oysterbench.core.trajectory import ReadOptions

ALIGNMENTS = ("none", "origin", "se3", "posyaw", "sim3", "scale")


def seconds(text: str) -> float | str:
    """Parse seconds, or the word 'estimate', which asks for them to be estimated. Raises ValueError."""
    try:
        return text if text == "estimate" else float(text)
    except ValueError:
        raise ValueError(f"expected seconds or 'estimate', got {text!r}") from None


SETTINGS = (
    Option("align", "--align", "Alignment with the ground truth.  [default: posyaw]", ALIGNMENTS),
    Option("align_first", "--align-first", "Fit the alignment to the first N poses.  [default: all]", int),
    Option(
        "associate", "--associate", "How timestamps are matched.  [default: interpolate]", ("interpolate", "nearest")
    ),
    Option("max_gap_s", "--max-gap", "Interpolate across at most this many seconds.  [default: 0.3]", float),
    Option(
        "max_difference_s", "--max-difference", "Match nearest poses at most this many s apart.  [default: 0.01]", float
    ),
    Option(
        "time_offset_s",
        "--time-offset",
        "Added to the estimate's timestamps; 'estimate' finds it from the motion.  [default: 0]",
        seconds,
        metavar="SECONDS|estimate",
    ),
    Option("rpe_pairs", "--rpe-pairs", "Relative errors from every pose, or end to end.", ("all", "consecutive")),
    Option(
        "subpath_m",
        "--subpath",
        "Length of segments in m; repeatable.  [default: shares of the path]",
        float,
        multiple=True,
    ),
)
"""Settings of the evaluator, each with the default used if it is not given."""

OF_BOTH: dict[str, tuple[Any, str]] = {
    "format": (("tum", "euroc", "kitti", "csv", "npz", "mcap", "bag"), "Format.  [default: from the content]"),
    "topic": (str, "Topic of an MCAP file or bag; /tf:map.base_link for one transform."),
    "time-unit": (("s", "ms", "us", "ns"), "Unit of the timestamps."),
    "quaternion": (("xyzw", "wxyz"), "Order of the quaternion."),
    "unit": (("m", "mm"), "Unit of the positions."),
    "duplicates": (
        ("first", "last", "mean", "refuse"),
        "Which of several poses at one timestamp.  [default: the first, if they are close]",
    ),
}
"""Options for reading the estimate and, with the prefix `truth-`, the ground truth: name -> kind and help text."""

READING = (
    *(
        Option(f"{prefix}{name}", f"--{prefix}{name}", f"{whose}: {text}", kind, files=True)
        for prefix, whose in (("", "Estimate"), ("truth-", "Ground truth"))
        for name, (kind, text) in OF_BOTH.items()
    ),
    Option(
        "times", "--times", "KITTI: A file with one time per line.  [default: the ground truth's]", Path, files=True
    ),
    Option(
        "direction",
        "--direction",
        "Estimate: What its poses transform, as in camera-to-world.  [default: body-to-world]",
        ("body-to-world", "world-to-body"),
        files=True,
    ),
    Option("frame", "--frame", "Estimate: Frame of the poses.", ("body", "optical"), files=True),
    Option(
        "T_body_estimate",
        "--T-body-estimate",
        "Estimate: Pose of its frame in the body: x,y,z,qx,qy,qz,qw or a 4 x 4 matrix.",
        files=True,
        metavar="NUMBERS|FILE",
    ),
    Option(
        "poses_of",
        "--poses-of",
        "Estimate: Frame of its poses in the sequence (of --truth): base, imu, camera, or a camera's name.",
        files=True,
        metavar="FRAME",
    ),
    Option("sort", "--sort", "Estimate: Sort the poses by timestamp.", bool, files=True),
)

OPTIONS = (*SETTINGS, *READING)


def read_options(given: Mapping[str, Any], truth_file: Path, estimate_file: Path) -> tuple[ReadOptions, ReadOptions]:
    """Options for reading the ground truth, and those for reading the estimate. truth_file: the ground truth, which
    has to be a sequence if the frame of the estimated poses is given by its name; estimate_file: the estimated poses,
    which are of the rectified camera where they are KITTI's."""
    from oysterbench.core.trajectory import ReadOptions, read_times

    times = read_times(given["times"], given.get("time-unit")) if "times" in given else None
    truth: dict[str, Any] = {key.replace("-", "_"): given.get(f"truth-{key}") for key in OF_BOTH}
    estimate: dict[str, Any] = {key.replace("-", "_"): given.get(key) for key in OF_BOTH}
    return (
        ReadOptions(**truth, times=times),
        ReadOptions(
            **estimate,
            times=times,
            direction=given.get("direction"),
            frame=given.get("frame"),
            T_body_estimate=_place(given, truth_file, estimate_file),
            sort=given.get("sort", False),
        ),
    )


def check_not_read(options: ReadOptions | None) -> None:
    """Raise OptionError where options say how the file of the ground truth is read, and it is a sequence: they would
    have no effect. The times of KITTI's poses are those of the estimate, too."""
    if options is None:
        return
    default = type(options)()
    names = [name for name in OF_BOTH if getattr(options, key := name.replace("-", "_")) != getattr(default, key)]
    if names:
        raise OptionError(
            f"{', '.join(f'--truth-{name}' for name in names)}: it says how a file is read, and the ground truth is a "
            "sequence, which says what its poses are: leave it out"
        )


def _place(given: Mapping[str, Any], truth_file: Path, estimate_file: Path) -> Any:
    """Transform (4, 4) that takes points of the estimate's frame into the body; None for the body's own frame."""
    if "poses_of" not in given:
        return _matrix(given["T_body_estimate"]) if "T_body_estimate" in given else None
    for key, name in (("T_body_estimate", "--T-body-estimate"), ("frame", "--frame")):
        if key in given:
            raise OptionError(f"--poses-of, {name}: both set the frame of the poses: expected only one")
    from oysterbench.core.trajectory import holds_kitti
    from oysterbench.methods.interfaces.slam import frame_pose
    from oysterbench.sequence import open_sequence

    try:
        sequence = open_sequence(truth_file)
    except SequenceError as error:
        raise OptionError(
            f"--poses-of {given['poses_of']}: expected a sequence with that frame (.mcap or a folder in EuRoC layout), "
            f"got {truth_file}; give that, or --T-body-estimate ({error})"
        ) from None
    form = given.get("format") or ("kitti" if holds_kitti(estimate_file) else "tum")
    return frame_pose(sequence, given["poses_of"], form)


def _matrix(text: str) -> Any:
    """Parse a transform (4, 4) from 7 or 16 numbers, or from a file that holds them. Raises OptionError."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from oysterbench.core.geometry import transform

    source = Path(text).read_text(encoding="utf-8", errors="replace") if Path(text).is_file() else text
    try:
        numbers = np.array(source.replace(",", " ").split(), dtype=float)
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) == 16:
        return numbers.reshape(4, 4)
    if len(numbers) == 7 and np.isfinite(numbers).all() and abs(np.linalg.norm(numbers[3:]) - 1) < 2e-3:
        return transform(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])
    raise OptionError(
        "--T-body-estimate: expected x,y,z,qx,qy,qz,qw or a 4 x 4 matrix, or a file with one of them, got "
        f"{text[:80]!r}"
    )
