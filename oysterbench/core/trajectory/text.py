"""Text formats of trajectories: TUM, EuRoC, KITTI, and CSV with a header that names its columns."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from oysterbench.core.errors import NoStampsError, TrajectoryError
from oysterbench.core.geometry import RIGID_TOLERANCE, Array
from oysterbench.core.trajectory.checks import checked_poses, others
from oysterbench.core.trajectory.clocks import held_against_clocks
from oysterbench.core.trajectory.columns import (
    EUROC,
    KITTI,
    KITTI_MATRIX,
    TUM,
    Columns,
    named_columns,
    named_quaternion,
    spread_word,
)
from oysterbench.core.trajectory.frames import METRES, scaled
from oysterbench.core.trajectory.options import EXPECTED, ReadOptions
from oysterbench.core.trajectory.poses import Trajectory
from oysterbench.core.trajectory.stamps import MIN_NANOSECONDS, SHIFTS, scaled_integer, scaled_integers
from oysterbench.core.trajectory.table import NUMBER, NumberTable, is_comment, read_table, split

MAX_SECONDS = 9e9
"""A stamp above this is not in seconds: it would be 285 years after the epoch, and overflow an int64 in nanoseconds."""
DECIMAL_COMMAS = re.compile(r"(?=.*,)([+-]?\d+(,\d+)?[;\s]+){5,}[+-]?\d+(,\d+)?;?")
"""Line of numbers separated by blanks or semicolons, as spreadsheets write it where the comma is the decimal sign."""
MARKUP = {"{": "JSON", "[": "JSON", "<": "HTML or XML"}
"""First character of a file -> what it is instead of a trajectory."""


def read_text(path: Path, data: bytes, options: ReadOptions) -> Trajectory:
    """Read a trajectory from a text file's bytes. Raises TrajectoryError naming file and line."""
    text = decoded(path, data)
    head = _Head.of(text)
    if head is None:
        found = "a header and " if text.strip() and not all(map(is_comment, text.split("\n"))) else ""
        raise TrajectoryError(f"{path} holds {found}no pose; expected lines of `t x y z qx qy qz qw`")
    line = text.split("\n", head.begin + 1)[head.begin].strip()
    if DECIMAL_COMMAS.fullmatch(line):
        raise TrajectoryError(
            f"{path}:{head.begin + 1}: expected numbers with decimal points, got decimal commas: {line[:60]!r}; "
            "export them with points"
        )
    columns = _columns(head, path, options)
    table = read_table(text, head.begin, columns, str(path))
    if columns.beyond is not None and not _in_parts(table, columns):
        columns = _columns(head, path, options, parts=False)
        table = read_table(text, head.begin, columns, str(path))
    if columns.stamp is None:
        return _kitti(table, path, options)
    if columns.beyond is not None and options.time_unit is not None:
        raise TrajectoryError(
            f"{path}: expected no unit of the stamps, which are in two columns, {head.names[columns.stamp]!r} and "
            f"{head.names[columns.beyond]!r}, of s and ns; leave --time-unit {options.time_unit} out"
        )
    columns = held_against_clocks(columns, text, head.begin, head.names, path, options.time_unit)
    place = {column: k for k, column in enumerate(columns.numbers)}
    notes: list[str] = []
    trajectory = Trajectory(
        _stamps(table, columns, path, options, notes),
        table.values[:, [place[k] for k in columns.position]],
        table.values[:, [place[k] for k in columns.quaternion]],
        _covariances(table.values, columns, place, path, notes),
        tuple(notes),
    )
    trajectory = checked_poses(trajectory, path.name, table.where, options)
    if columns.unit == "mm" and options.unit is None:
        return scaled(trajectory, METRES["mm"])
    return trajectory


def is_kitti(path: Path, data: bytes) -> bool:
    """Whether `read_text` takes a file's bytes for KITTI's poses. Raises TrajectoryError where it cannot read them."""
    head = _Head.of(decoded(path, data))
    return head is not None and _layout(head, path, ReadOptions(), parts=True) is KITTI


def read_times(path: Path, unit: str | None = None) -> NDArray[np.int64]:
    """Read stamps (N,) int64 ns from a file with one number per line, by default in seconds unless they can only be
    ns. Raises TrajectoryError where lines are of different units, or can be neither."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise TrajectoryError(
            f"{path}: cannot be read: {error.strerror or error}; expected one time per line"
        ) from None
    numbers, texts = [], []
    for number, line in enumerate(decoded(path, data).split("\n"), 1):
        if is_comment(line):
            continue
        fields = split(line)
        if len(fields) != 1 or not NUMBER.fullmatch(fields[0]):
            raise TrajectoryError(f"{path}:{number}: expected one time, got {line.strip()[:60]!r}")
        numbers.append(number)
        texts.append(fields[0])
    sizes = np.abs(np.array(texts, dtype=float))
    huge = sizes >= MIN_NANOSECONDS
    if unit is None:
        unit = "ns" if len(sizes) and huge.all() else "s"
    if unit == "s" and (wrong := sizes > MAX_SECONDS).any():
        i = int(np.argmax(wrong))
        raise TrajectoryError(
            f"{path}:{numbers[i]}: expected a time in seconds, or nanoseconds since 1970 on every line, got "
            f"{texts[i]}; say which they are (--time-unit ms, us or ns)"
        )
    times = []
    for number, text in zip(numbers, texts, strict=True):
        try:
            times.append(scaled_integer(text, SHIFTS[unit]))
        except ValueError as error:
            raise TrajectoryError(f"{path}:{number}: {error}") from None
    try:
        return np.array(times, dtype=np.int64)
    except OverflowError:
        raise TrajectoryError(f"{path}: expected times of at most 2^63 ns") from None


def decoded(path: Path, data: bytes) -> str:
    """Decode UTF-8 text, with lines ending in a line feed and no byte order mark. Raises TrajectoryError for others."""
    if b"\0" not in data:
        try:
            text = data.decode("utf-8-sig")
            if markup := MARKUP.get(text.lstrip()[:1]):
                raise TrajectoryError(f"{path}: it is {markup}; {EXPECTED}")
            return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
        except UnicodeDecodeError:
            pass
    raise TrajectoryError(f"{path} is not text; {EXPECTED}")


@dataclass(frozen=True)
class _Head:
    """What precedes the first pose of a file, and that pose.

    names: of the columns, from a header line or else from a comment before the poses; empty where there are none
    certain: whether the names come from a header line
    comments: fields of those comments before the poses that name a quaternion
    begin: line of the first pose, counted from 0
    first: its fields
    commas: whether it has commas or semicolons
    """

    names: list[str]
    certain: bool
    comments: list[list[str]]
    begin: int
    first: list[str]
    commas: bool

    @classmethod
    def of(cls, text: str) -> _Head | None:
        names: list[str] = []
        comments: list[list[str]] = []
        certain = False
        start = number = 0
        while start <= len(text):
            end = text.find("\n", start)
            line = text[start : end if end >= 0 else len(text)]
            if line.strip():
                fields = split(line.strip().lstrip("#%").strip())
                if is_comment(line):
                    if not certain and named_columns(fields):
                        names = fields
                    elif named_quaternion(fields):
                        comments.append(fields)
                elif not certain and _is_header(split(line)):
                    names, certain = split(line.rstrip(" \t,;")), True
                else:
                    return cls(names, certain, comments, number, split(line), "," in line or ";" in line)
            if end < 0:
                break
            start, number = end + 1, number + 1
        return None


def _is_header(fields: list[str]) -> bool:
    """Whether the fields are column names: no field is a number, and one at least is a word. An index may have none."""
    numbers = any(NUMBER.fullmatch(field) or field.lower().lstrip("+-") in ("nan", "inf") for field in fields)
    return not numbers and any(fields)


def _columns(head: _Head, path: Path, options: ReadOptions, parts: bool = True) -> Columns:
    """Column layout: as requested, as a header names it, or as the number of columns and their separator indicate, with
    the requested order of the quaternion. parts: whether two columns may make up one stamp."""
    columns = _layout(head, path, options, parts)
    first = min(columns.quaternion, default=0)
    if options.quaternion is not None and sorted(columns.quaternion) == list(range(first, first + 4)):
        order = (0, 1, 2, 3) if options.quaternion == "xyzw" else (1, 2, 3, 0)
        columns = replace(columns, quaternion=tuple(first + k for k in order))
    if options.format is None and not columns.named:
        _check_comments(head, path, columns, options.quaternion is not None)
    return columns


def _check_comments(head: _Head, path: Path, columns: Columns, asked: bool) -> None:
    """Refuse a comment that names the quaternion, in other columns than a layout without names has it: it is known to
    be another layout, though not which. asked: whether the order is, so that it is not the comment's that counts"""
    for names in head.comments:
        found = named_quaternion(names).items()
        elsewhere = any(
            k not in (columns.quaternion if asked else columns.quaternion[axis : axis + 1]) for axis, k in found
        )
        if elsewhere and len(names) == len(head.first):
            order = "" if asked else " or the order (--quaternion xyzw or wxyz)"
            raise TrajectoryError(
                f"{path}: expected a comment that names a column for each of t, x, y, z, qx, qy, qz, qw, or columns "
                f"`{columns.kind}`, got {','.join(names)[:80]!r}{_of_spreads(names)}; correct it, or name the format "
                f"(--format tum or euroc){order}"
            )


def _of_spreads(names: list[str]) -> str:
    """What to add to an error on names, where a word in them is why they are those of no pose."""
    found = spread_word(names)
    return f", where {found[0]!r} in {found[1]!r} says that it is a spread (rename it if it is not)" if found else ""


def _layout(head: _Head, path: Path, options: ReadOptions, parts: bool) -> Columns:
    named = named_columns(head.names, parts, options.time_unit) if len(head.names) <= len(head.first) else None
    if options.format == "kitti":
        return KITTI
    if options.format == "tum":
        return TUM
    if options.format == "euroc":
        return replace(EUROC, time_unit="ns")
    if named and named.rivals:
        raise TrajectoryError(
            f"{path}: expected the columns of one stamp and one pose, got {named.rivals[0]!r} and {named.rivals[1]!r}, "
            "which may be of several; delete those that are not meant, or rename them"
        )
    if named and " and " in named.unit:
        raise TrajectoryError(
            f"{path}: expected a header that names x, y, z in m or in mm, got {named.unit}: no one unit is right; "
            "convert them, and correct their names"
        )
    if named and named.unit not in METRES and options.unit is None:
        raise TrajectoryError(
            f"{path}: expected a header that names x, y, z in m or mm, got {named.unit!r}; convert them, or say which "
            "they are (--unit m or mm)"
        )
    if named:
        return replace(named, euroc=head.commas and named.stands_as_euroc)
    if options.format == "csv" or head.certain:
        angles = {name.lower() for name in head.names} & {"roll", "pitch", "yaw"}
        if angles:
            raise TrajectoryError(
                f"{path}: expected the attitude as a quaternion in columns qx, qy, qz, qw, got "
                f"{', '.join(head.names)}; convert it (scipy: "
                "Rotation.from_euler('ZYX', [yaw, pitch, roll]).as_quat() gives x y z w)"
            )
        raise TrajectoryError(
            f"{path}: expected a header that names a column for each of t, x, y, z, qx, qy, qz, qw, got "
            f"{','.join(head.names)[:80] or 'none'!r} over {len(head.first)} columns{_of_spreads(head.names)}; correct "
            "it, or name the format (--format tum or euroc)"
        )
    if head.commas:
        return EUROC
    if len(head.first) == 12:
        return KITTI
    return TUM


def _stamps(
    table: NumberTable, columns: Columns, path: Path, options: ReadOptions, notes: list[str]
) -> NDArray[np.int64]:
    """Stamps (N,) int64 ns. Their unit is the requested one, or that of the layout, or the one that their size
    implies."""
    sizes = np.abs(table.sizes)
    if columns.beyond is not None:
        return table.sizes.astype(np.int64) * 10**9 + _beyond(table, columns).astype(np.int64)
    unit = options.time_unit or columns.time_unit
    if unit is None:
        huge = sizes >= MIN_NANOSECONDS
        if huge.all():
            unit = "ns"
            if not columns.euroc:
                notes.append(f"{path.name}: the timestamps can only be nanoseconds and are read as such")
        elif huge.any():
            i = int(np.argmax(huge != huge[0]))
            kind = ("nanoseconds", "s") if huge[0] else ("s", "nanoseconds")
            raise TrajectoryError(
                f"{table.where(i)}: expected timestamps in {kind[0]} as on the lines before, got {kind[1]}: "
                f"{table.stamp(i)}"
            )
        elif columns.euroc and not (broken := _broken(table.stamps)).any():
            unit = "ns"
        elif columns.euroc and not columns.named:
            i = int(np.argmax(broken))
            raise TrajectoryError(
                f"{table.where(i)}: expected a timestamp in whole nanoseconds, since lines with commas are EuRoC, got "
                f"{table.stamp(i)}; write `t x y z qx qy qz qw` with spaces for timestamps in seconds, name the "
                "columns in a header, or name the format (--format tum, --time-unit s)"
            )
        else:
            unit = "s"
    if unit == "s":
        wrong = sizes > MAX_SECONDS
        if wrong.any():
            i = int(np.argmax(wrong))
            raise TrajectoryError(
                f"{table.where(i)}: expected a timestamp in seconds (or nanoseconds since 1970), got "
                f"{table.stamp(i)}{others(wrong)}, which looks like milli-, micro- or nanoseconds; write "
                "seconds, or say which they are (--time-unit ms, us or ns)"
            )
    try:
        return scaled_integers(table.stamps, SHIFTS[unit])
    except (ValueError, OverflowError):
        i = next(i for i, text in enumerate(table.stamps.tolist()) if not _fits(text.decode(), SHIFTS[unit]))
        raise TrajectoryError(f"{table.where(i)}: expected at most 2^63 ns, got {table.stamp(i)}") from None


def _in_parts(table: NumberTable, columns: Columns) -> bool:
    """Whether two columns can be one stamp: whole seconds, and whole nanoseconds of less than a second."""
    beyond = _beyond(table, columns)
    whole = (table.sizes == np.floor(table.sizes)) & (beyond == np.floor(beyond))
    return bool((whole & (beyond >= 0) & (beyond < 1e9) & (np.abs(table.sizes) <= MAX_SECONDS)).all())


def _beyond(table: NumberTable, columns: Columns) -> Array:
    assert columns.beyond is not None
    return table.values[:, columns.numbers.index(columns.beyond)]


def _broken(stamps: NDArray[np.bytes_]) -> NDArray[np.bool_]:
    """Mask (N,) of the stamps that are not written as whole numbers."""
    characters = stamps.view(np.uint8).reshape(len(stamps), -1)
    return np.asarray(np.isin(characters, [ord(sign) for sign in ".eE"]).any(axis=1))


def _fits(text: str, shift: int) -> bool:
    try:
        return -(2**63) < scaled_integer(text, shift) < 2**63
    except ValueError:
        return False


def _covariances(values: Array, columns: Columns, place: dict[int, int], path: Path, notes: list[str]) -> Array | None:
    if not columns.covariance:
        return None
    if not columns.whole_covariance:
        notes.append(f"{path.name}: its covariances are left out: {len(columns.covariance)} columns are not all of one")
        return None
    covariances = np.empty((len(values), 6, 6))
    for i in range(6):
        for j in range(6):
            column = columns.covariance.get((i, j), columns.covariance.get((j, i), 0))
            covariances[:, i, j] = values[:, place[column]]
    return covariances


def _kitti(table: NumberTable, path: Path, options: ReadOptions) -> Trajectory:
    """Convert the top three rows of KITTI's matrices to poses, with stamps from `options.times`."""
    if options.times is None:
        raise NoStampsError(
            f"{path}: KITTI poses have no timestamps; write lines of TUM, or give a file with one time per line "
            f"(--times FILE), or ground truth with as many poses ({len(table)})",
            len(table),
        )
    if len(options.times) != len(table):
        raise TrajectoryError(
            f"{path}: expected a time for each of {len(table)} poses, got {len(options.times)} times; give a file with "
            "one time per line (--times FILE)"
        )
    rotations = table.values[:, KITTI_MATRIX].reshape(-1, 3, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        products = np.einsum("nki,nkj->nij", rotations, rotations)
        off = np.abs(products - np.eye(3)).max(axis=(1, 2))
        wrong = np.asarray(~(off <= RIGID_TOLERANCE) | ~(np.linalg.det(rotations) > 0))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise TrajectoryError(
            f"{table.where(i)}: expected the columns 1-3, 5-7, 9-11 to be a rotation matrix, got one that is off by "
            f"{off[i]:.2g}{others(wrong)}"
        )
    quaternions = scipy.spatial.transform.Rotation.from_matrix(rotations).as_quat()
    notes = (f"{path.name}: its {len(table)} poses carry no timestamps and take the given times one to one",)
    stamps_ns = np.asarray(options.times, dtype=np.int64)
    trajectory = Trajectory(stamps_ns, table.values[:, [3, 7, 11]].copy(), quaternions, notes=notes)
    return checked_poses(trajectory, path.name, table.where, options)
