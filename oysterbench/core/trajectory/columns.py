"""Which column of a text file holds what: from its header, or from the usual layouts of files without one."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

QUATERNION_WORDS = {"q", "quat", "quaternion", "orientation", "rotation", "rot", "attitude"}
POSITION_WORDS = {"p", "pos", "position", "t", "trans", "translation", "location"}
TIME_WORDS = {"t", "ts", "time", "times", "timestamp", "timestamps", "stamp", "stamps"}
UNIT_WORDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millisec", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "microsec", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"), "ns"),
}
PARTS = {
    **dict.fromkeys(("sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"), "ns"),
}
"""Last words of the names of two columns that make up one stamp, as tools for ROS write its fields: whole seconds, and
the nanoseconds beyond them."""
LENGTH_WORDS = {
    **dict.fromkeys(("", "m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
}
COVARIANCE_WORDS = {"cov", "covariance", "covariances"}
COVARIANCE_AXES = {name: k // 2 for k, name in enumerate(("x", "px", "y", "py", "z", "pz"))} | {
    f"{prefix}{axis}": 3 + k for prefix in ("r", "rot") for k, axis in enumerate("xyz")
}


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
    unit:       unit of the positions: m or mm
    exact:      how many columns a line must have; None: as many as the first line
    named:      whether a header named the columns
    euroc:      whether it is EuRoC's own layout, in which whole stamps are ns
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


def named_columns(names: list[str], two_parts: bool = True) -> Columns | None:
    """Columns that a header names, or None where it does not name a stamp, a position and a quaternion. two_parts:
    whether a stamp may be in two columns."""
    found: dict[str, int] = {}
    covariance: dict[tuple[int, int], int] = {}
    stamp: tuple[int, str | None] | None = None
    units: set[str | None] = set()
    parts: dict[tuple[str, ...], dict[str, int]] = {}
    for k, name in enumerate(names):
        words, unit = _words(name)
        if cell := _covariance_cell(words):
            covariance.setdefault(cell, k)
        elif role := _role(words):
            found.setdefault(role, k)
            units |= {LENGTH_WORDS.get(unit)} if role.startswith("p") else set()
        elif _is_time(words) and (stamp is None or "stamp" in words):
            spelled = next((UNIT_WORDS[word] for word in words if word in UNIT_WORDS), None)
            stamp = (k, UNIT_WORDS.get(unit, spelled))
        if words and words[-1] in PARTS and (len(words) == 1 or _is_time(words)):
            parts.setdefault(tuple(words[:-1]), {}).setdefault(PARTS[words[-1]], k)
    beyond = None
    if two_parts and (whole := next((found for found in parts.values() if {"s", "ns"} <= found.keys()), None)):
        stamp, beyond = (whole["s"], "s"), whole["ns"]
    if stamp is None or not {"px", "py", "pz", "qx", "qy", "qz", "qw"} <= found.keys() or units not in ({"m"}, {"mm"}):
        return None
    return Columns(
        ",".join(names)[:80],
        stamp[0],
        tuple(found[f"p{axis}"] for axis in "xyz"),
        tuple(found[f"q{axis}"] for axis in "xyzw"),
        covariance,
        beyond,
        stamp[1],
        "mm" if "mm" in units else "m",
        named=True,
    )


def _words(name: str) -> tuple[list[str], str]:
    """Lower-case words of a column's name, and its unit, if given in brackets or as the last word."""
    bracket = re.search(r"[\[(]\s*([a-zA-Z]*)\s*[\])]\s*$", name)
    words = re.findall(r"[a-z]+|[0-9]+", (name[: bracket.start()] if bracket else name).lower())
    if bracket:
        return words, bracket.group(1).lower()
    return (words[:-1], words[-1]) if len(words) > 1 and words[-1] in LENGTH_WORDS else (words, "")


def _role(words: list[str]) -> str | None:
    """Role that a column's words name: `px` to `pz`, `qx` to `qw`, or None."""
    if not words:
        return None
    *before, last = words
    if re.fullmatch(r"q[xyzw]|[pt][xyz]", last):
        before, last = [*before, last[0]], last[1]
    if last not in set("xyzw"):
        return None
    if QUATERNION_WORDS & set(before):
        return f"q{last}"
    if last != "w" and (not before or POSITION_WORDS & set(before)):
        return f"p{last}"
    return "qw" if last == "w" and not before else None


def _is_time(words: list[str]) -> bool:
    """Whether a name is that of a stamp: `t`, `timestamp_ns`, `field.header.stamp`."""
    core = [word for word in words if word not in UNIT_WORDS and word not in ("field", "header")]
    return len(core) == 1 and core[0] in TIME_WORDS


def _covariance_cell(words: list[str]) -> tuple[int, int] | None:
    """Cell of the matrix that a name such as `cov_7`, `cov_x_ry` or `pose.covariance[7]` means, or None."""
    place = next((k for k, word in enumerate(words) if word in COVARIANCE_WORDS), None)
    if place is None:
        return None
    rest = words[place + 1 :]
    if len(rest) == 1 and rest[0].isdigit() and int(rest[0][:9]) < 36:
        return divmod(int(rest[0]), 6)
    if len(rest) == 2 and all(word in COVARIANCE_AXES for word in rest):
        return COVARIANCE_AXES[rest[0]], COVARIANCE_AXES[rest[1]]
    return None
