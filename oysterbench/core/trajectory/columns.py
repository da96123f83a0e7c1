"""Which column of a text file holds what: from its header, or from the usual layouts of files without one."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from oysterbench.core.trajectory.names import (
    LENGTH_WORDS,
    POSITION_WORDS,
    QUATERNION_WORDS,
    STAMP_WORDS,
    UNIT_WORDS,
    Prefix,
    covariance_cell,
    role_of,
    time_unit_of,
    time_words,
    topic_of,
    words_of,
)

PARTS = {
    **dict.fromkeys(("sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"), "ns"),
}
"""Last words of the names of two columns that make up one stamp, as tools for ROS write its fields: whole seconds, and
the nanoseconds beyond them."""
SURE_SPREADS = {"std", "stddev", "stdev", "variance", "rms", "rmse"}
"""Words in the names of columns that say how far off a pose is, and are no pose."""
SPREAD_WORDS = SURE_SPREADS | {"sd", "sigma", "var", "err", "error"}
"""All such words. Those that are not sure may be part of a topic's name where it alone has a whole pose, as
`/error_state_kf/pose/position/x`."""
COLUMN_SPREADS = SPREAD_WORDS | {"dev", "deviation", "uncertainty", "cov", "covariance", "covariances"}
"""Such words outside a topic's name, where some say nothing, as in `/pose_with_covariance/pose/position/x`."""
NAME_WORDS = {"dev", "cov", "covariance", "covariances"}
"""Those that names of topics end in, as `pose_with_covariance`, and that say nothing there."""
FIELDS = {"position", "orientation", "translation", "rotation"}
"""Fields of the messages that hold poses: what precedes them is the name of a topic."""
POSE_ROLES = {"px", "py", "pz", "qx", "qy", "qz", "qw"}
LONGEST_FRAMES = 3
"""Letters of a word that is taken for those of frames."""


@dataclass(frozen=True)
class Columns:
    """Columns of a text file, counted from 0.

    kind:       name of the layout, as an error shows it
    stamp:      column of the stamp, or None (KITTI)
    position:   columns of x, y, z
    quaternion: columns of x, y, z, w; empty for KITTI, whose 12 numbers are the top three rows of a matrix
    covariance: (row, column) of the 6 x 6 matrix -> column of the file
    beyond:     column of the nanoseconds beyond the whole seconds of the stamp, where they are in two columns
    time_unit:  unit of the stamps, where the layout fixes it
    unit:       unit of the positions: m, mm, or what a header says in place of them
    exact:      how many columns a line must have; None: as many as the first line
    named:      whether a header named the columns
    euroc:      whether it is EuRoC's own layout, in which whole stamps are ns
    rivals:     names of two columns of which a header does not say which one is meant; empty where there are none
    clocks:     other columns of times that the stamps can be held against: each with its unit, None where its name
                does not say it, and whether it is of the stamp's name but for the unit
    """

    kind: str
    stamp: int | None
    position: tuple[int, ...]
    quaternion: tuple[int, ...]
    covariance: dict[tuple[int, int], int] = field(default_factory=dict)
    beyond: int | None = None
    time_unit: str | None = None
    unit: str = "m"
    exact: int | None = None
    named: bool = False
    euroc: bool = False
    rivals: tuple[str, ...] = ()
    clocks: tuple[tuple[int, str | None, bool], ...] = ()

    @property
    def numbers(self) -> list[int]:
        """Columns other than the stamp that must hold finite numbers; each once, in the order of the file."""
        if self.stamp is None:
            return list(range(self.exact or 0))
        beyond = () if self.beyond is None else (self.beyond,)
        return sorted({*self.position, *self.quaternion, *self.covariance.values(), *beyond})

    @property
    def whole_covariance(self) -> bool:
        """Whether every cell of the matrix, or its transpose, is named."""
        cells = self.covariance
        return all((i, j) in cells or (j, i) in cells for i in range(6) for j in range(i, 6))

    @property
    def stands_as_euroc(self) -> bool:
        """Whether the columns are in the order of EuRoC's ground truth: t x y z qw qx qy qz."""
        return (self.stamp, self.position, self.quaternion) == (0, (1, 2, 3), (5, 6, 7, 4))


TUM = Columns("t x y z qx qy qz qw", 0, (1, 2, 3), (4, 5, 6, 7), exact=8)
EUROC = Columns("t,x,y,z,qw,qx,qy,qz", 0, (1, 2, 3), (5, 6, 7, 4), euroc=True)
KITTI = Columns("12 numbers r11 r12 r13 tx ... r33 tz", None, (3, 7, 11), (), exact=12)
KITTI_MATRIX = (0, 1, 2, 4, 5, 6, 8, 9, 10)


@dataclass(frozen=True)
class _Time:
    """A time that a header names, in one column or in two.

    topic:  words before those of a message's header, as of `/vio/header/stamp`; else empty
    words:  those after them
    column: where it is, or its whole seconds
    unit:   as the name says it; None where it does not
    beyond: column of the nanoseconds beyond the whole seconds, where it is in two
    """

    topic: Prefix
    words: tuple[str, ...]
    column: int
    unit: str | None = None
    beyond: int | None = None

    @property
    def rank(self) -> tuple[bool, bool]:
        """The lowest is the stamp of the poses: in two columns, as tools for ROS write them, or one called so, as that
        of the poses' own topic in a recording of several; else a time, which may be that of the recording."""
        return self.beyond is None and not STAMP_WORDS & set(self.words), self.beyond is None

    @property
    def bare(self) -> list[str]:
        """Words of its name but for the unit."""
        return [*self.topic, *(word for word in self.words if word not in UNIT_WORDS)]


def named_columns(names: list[str], two_parts: bool = True, time_unit: str | None = None) -> Columns | None:
    """Columns that a header names, or None where it does not name a stamp, a position and a quaternion. two_parts:
    whether a stamp may be in two columns; time_unit: of the one that is meant, where there are several."""
    named = [words_of(name) for name in names]
    found: dict[Prefix, dict[str, list[tuple[int, str]]]] = {}
    before: dict[Prefix, int] = {}
    covariance: dict[tuple[int, int], int] = {}
    for k, (words, _) in enumerate(named):
        if cell := covariance_cell(words):
            covariance.setdefault(cell, k)
        elif role := role_of(words):
            found.setdefault(role.whose, {}).setdefault(role.role, []).append((k, role.word))
            before.setdefault(role.whose, role.before)
    alone = {prefix: _consistent(columns) for prefix, columns in found.items()}
    poses = {prefix: columns for prefix, columns in alone.items() if not _of_spreads(prefix, alone, before[prefix])}
    topics = {
        prefix
        for prefix in poses
        if before[prefix] == len(prefix) and {word for of in found[prefix].values() for _, word in of} <= FIELDS
    }
    bare = {tuple(words) for words, _ in named}
    unknown = {one for one in poses if "px" not in poses[one] and all((*one, axis) in bare for axis in "xyz")}
    pose = _pose(poses, topics, unknown)
    if pose is None:
        return None
    position, quaternion, of_pose = pose
    of_message = topic_of(named[position[0]][0])
    times = [one for one in _times(named, two_parts) if one.topic == of_message[: len(one.topic)]]
    if any(_letter(name) == "t" for name in names):  # beside which T is a temperature
        times = [one for one in times if _letter(names[one.column]) != "T" or one.unit]
    if not times:
        return None
    stamp, of_stamps = _stamp(times, time_unit)
    lengths = dict.fromkeys(LENGTH_WORDS.get(named[k][1], named[k][1]) for k in position)
    return Columns(
        ",".join(names)[:80],
        stamp.column,
        tuple(position),
        tuple(quaternion),
        covariance,
        stamp.beyond,
        stamp.unit,
        " and ".join(lengths),
        named=True,
        rivals=tuple(names[k] for k in of_pose or of_stamps),
        clocks=_clocks(stamp, times),
    )


def named_quaternion(names: list[str]) -> dict[int, int]:
    """Columns of the x, y, z, w of a quaternion, 0 to 3, as far as names say them, whatever the other columns are."""
    found: dict[int, int] = {}
    for k, name in enumerate(names):
        role = role_of([word for word in words_of(name)[0] if word not in SPREAD_WORDS])
        if role and role.role[0] == "q" and role.word:
            found.setdefault("xyzw".index(role.role[1]), k)
    return found


def spread_word(names: list[str]) -> tuple[str, str] | None:
    """Word of a spread, and the name that has it, for which a header names no pose; None where that is not why."""
    split = [words_of(name)[0] for name in names]
    plain = ["_".join(word for word in words if word not in COLUMN_SPREADS) for words in split]
    if named_columns(names) is not None or named_columns(plain) is None:
        return None
    of_poses = ((words, name) for words, name in zip(split, names, strict=True) if role_of(words))
    return next(((word, name) for words, name in of_poses for word in words if word in COLUMN_SPREADS), None)


def _of_spreads(prefix: Prefix, found: dict[Prefix, dict[str, list[int]]], before: int) -> bool:
    """Whether a prefix is of the spreads of a pose, which are none and stand in the way of none: with a word of them
    outside the topic of a message, but for sd_px, which may be of a method. A whole pose is one only where the word is
    sure or next to the field, as in sigma_p_W, or where the pose of the name without it is beside it.

    found: the roles of each; before: how many of its words stand before the field
    """
    whole = found[prefix].keys() >= POSE_ROLES
    outside = set() if prefix == ("sd",) else _outside(prefix)
    name = prefix[:before] if prefix[:before][-2:-1] != ("with",) else ()  # pose_with_uncertainty is the name of a pose
    next_to = (COLUMN_SPREADS - NAME_WORDS) & {*name[-1:]} or COLUMN_SPREADS & {*prefix[before:]}
    if outside and (not whole or SURE_SPREADS & outside or next_to):
        return True
    known = COLUMN_SPREADS if outside else SPREAD_WORDS
    if not known & set(prefix):
        return False
    plain = _named(word for word in prefix if word not in known)
    beside = any(_named(one) == plain and {"px", "py", "pz"} <= found[one].keys() for one in found if one != prefix)
    return not whole or (beside and (bool(outside) or _ends_as_spread(prefix)))


def _named(words: Iterable[str]) -> Prefix:
    """Words of a prefix by which a pose and its spreads are known to be of one name."""
    return tuple(word for word in topic_of(words) if word not in POSITION_WORDS | QUATERNION_WORDS)


def _outside(prefix: Prefix) -> set[str]:
    """Words of a spread outside the topic of a message."""
    return COLUMN_SPREADS & set(prefix[len(_path(prefix)) :])


def _ends_as_spread(prefix: Prefix) -> bool:
    """Whether the last word of a topic, or of a prefix without one, is that of a spread."""
    said = [word for word in _path(prefix) or prefix if word not in ("field", "pose")]
    return bool(SPREAD_WORDS.intersection(said[-1:]))


def _path(prefix: Prefix) -> Prefix:
    """Words of the topic of a message: those before the last `pose` or `transform`; empty where there is none."""
    return prefix[: max((k for k, word in enumerate(prefix) if word in ("pose", "transform")), default=0)]


def _consistent(found: dict[str, list[tuple[int, str]]]) -> dict[str, list[int]]:
    """Columns of each role, from columns and the words that say it: where one word has all axes, those of another that
    lacks some are no part of the pose, as Euler's angles rot_x, rot_y, rot_z beside qx to qw."""
    chosen: dict[str, list[int]] = {}
    for roles in (("px", "py", "pz"), ("qx", "qy", "qz", "qw")):
        columns = {role: found[role] for role in roles if role in found}
        words = {word for of in columns.values() for _, word in of}
        whole = {word for word in words if all(word in {one for _, one in columns.get(role, ())} for role in roles)}
        for role, of in columns.items():
            chosen[role] = [k for k, word in of if word in (whole or words)]
    return {role: of for role, of in chosen.items() if of}


def _pose(
    found: dict[Prefix, dict[str, list[int]]], topics: set[Prefix], unknown: set[Prefix]
) -> tuple[list[int], list[int], list[int]] | None:
    """Columns of the position, those of the quaternion, and two that may be of several poses, from the columns of each
    prefix and role; None where there is no whole pose. topics: prefixes that are a topic's name; unknown: those of
    columns such as gt_x, which are the position of a pose beside gt_qx, but have no role by themselves"""
    positions = [one for one in found if {"px", "py", "pz"} <= found[one].keys()]
    attitudes = [one for one in found if {"qx", "qy", "qz", "qw"} <= found[one].keys()]
    if not positions or not attitudes:
        return None
    first = positions[0]
    # Of EuRoC's names, those of a position, p_RS_R, have one frame more than those of an attitude, q_RS.
    attitude = first if first in attitudes else next((one for one in attitudes if _nested(one, first)), attitudes[0])
    position = [found[first][f"p{axis}"] for axis in "xyz"]
    quaternion = [found[attitude][f"q{axis}"] for axis in "xyzw"]
    rivals = next((same[:2] for same in (*position, *quaternion) if len(same) > 1), [])
    if len(positions) > 1:
        rivals = [position[0][0], found[positions[1]]["px"][0]]
    elif len(attitudes) > 1 and (attitude != first or (first != ("sd",) and not rivals and unknown & {*attitudes})):
        rivals = [found[one]["qx"][0] for one in attitudes[:2]]
    elif not _nested(attitude, first):
        rivals = [position[0][0], quaternion[0][0]]
    elif first not in topics and first != ("sd",) and _outside(first):
        return None  # cov_p_W and cov_q_W may be the spreads of a pose whose names are not known
    elif SPREAD_WORDS & {*first, *attitude} and (
        attitude != first or _ends_as_spread(first) or SURE_SPREADS & set(first)
    ):
        return None
    return [k for k, *_ in position], [k for k, *_ in quaternion], rivals


def _times(named: list[tuple[list[str], str]], two_parts: bool) -> list[_Time]:
    """Times that the columns hold, from the words and the unit of each name."""
    times: list[_Time] = []
    parts: dict[tuple[Prefix, tuple[str, ...]], dict[str, int]] = {}
    for k, (words, unit) in enumerate(named):
        of = time_words(words)
        if of is not None:
            times.append(_Time(*of, k, time_unit_of(of[1], unit)))
        elif len(words) == 1:
            of = (), tuple(words)
        if of is not None and of[1][-1] in PARTS:
            parts.setdefault((of[0], of[1][:-1]), {}).setdefault(PARTS[of[1][-1]], k)
    whole = [
        _Time(*name, part["s"], "s", part["ns"])
        for name, part in parts.items()
        if two_parts and {"s", "ns"} <= part.keys()
    ]
    used = {k for one in whole for k in (one.column, one.beyond)}
    return [*whole, *(one for one in times if one.column not in used)]


def _stamp(times: list[_Time], unit: str | None) -> tuple[_Time, list[int]]:
    """Which of several times is the stamp: the first of the lowest rank, among those in the unit that is asked for if a
    name has it, or one that says its unit where none is asked for; and two columns that may be it, where their names
    differ in more than the unit."""
    if unit is not None and any(one.unit == unit and one.beyond is None for one in times):
        times = [one for one in times if one.unit == unit or one.beyond is not None]
    # Beside the stamp of a message, a time in two columns that are not called so is that of the recording.
    if any({"stamp", "stamps"} & set(one.words) for one in times):
        times = [one for one in times if one.beyond is None or STAMP_WORDS & set(one.words) or not one.bare]
    lowest = min(one.rank for one in times)
    times = [one for one in times if one.rank == lowest]
    if any("header" in one.words for one in times):
        times = [one for one in times if one.bare]
    stamp = next((one for one in times if (one.unit is None) == (unit is not None)), times[0])
    other = next((one for one in times if one.bare != times[0].bare), None)
    return stamp, [] if other is None else [times[0].column, other.column]


def _clocks(stamp: _Time, times: list[_Time]) -> tuple[tuple[int, str | None, bool], ...]:
    """`Columns.clocks`: the times of the stamp's name but for the unit, and where that says no unit, those that do."""
    single = [one for one in times if one is not stamp and stamp.beyond is None and one.beyond is None]
    clocks = ((one.column, one.unit, one.bare == stamp.bare) for one in single)
    return tuple((k, unit, same) for k, unit, same in clocks if same or (unit is not None and stamp.unit is None))


def _letter(name: str) -> str:
    """The letter that a name is but for a unit, in brackets or after a mark; else the name."""
    alone = re.fullmatch(rf"([a-zA-Z])([\s_]*[\[(][^\])]*[\])]|[\s_]+({'|'.join(UNIT_WORDS)}))?", name.strip())
    return alone[1] if alone else name


def _nested(one: Prefix, other: Prefix) -> bool:
    """Whether one of two prefixes begins with the other, as words or, of frames, as letters: W and WB of p_W, q_WB."""
    least = min(len(one), len(other))
    frames = len(one) == len(other) == 1 and max(len(one[0]), len(other[0])) <= LONGEST_FRAMES
    return one[:least] == other[:least] or (frames and (one[0].startswith(other[0]) or other[0].startswith(one[0])))
