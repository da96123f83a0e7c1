"""The header of a table of inertial samples in EuRoC layout: whether its columns are those of the layout."""

from __future__ import annotations

import re
from pathlib import Path

from oysterbench.core.errors import SequenceError
from oysterbench.core.trajectory.columns import MICRO, UNIT_WORDS

RATE, FORCE = "angular rate in rad/s", "specific force in m/s^2"
WORDS = {
    RATE: {"w", "g", "gyr", "gyro", "gyroscope", "omega", "angular"},
    FORCE: {"a", "f", "acc", "accel", "acceleration", "accelerometer", "linear", "force"},
}
"""Words in the names of columns, by what they hold."""

UNITS = {RATE: {"", "rad/s", "rads-1", "1/s", "s-1"}, FORCE: {"", "m/s2", "ms-2", "m/s/s"}}
"""Units of each, as `_unit` writes them."""

OTHER_UNITS = re.compile(r"deg.*|m?dps|rpm|mrad|[mu]?g|[cm]m(s|ps)?")
"""First word of the units that stand after the axis in the names of some tables, as in `gyro_x_deg_per_s`."""

OTHER_TIMES = {"tick", "ticks", "counts", "cycles", "frames", "samples"} | {
    *("min", "mins", "minute", "minutes", "h", "hr", "hrs", "hour", "hours", "day", "days", "ps", "picoseconds")
}
"""Words of units that stamps are not read in."""
NANO = re.compile(r"(?:e|\^|\*\*)\s*[-+]?0?9(?!\d)|\u207b\u2079")
"""The power of ten of nanoseconds, as in `[1e-9 s]`."""
BRACKET = r"[\[(]([^\])]*)[\])]"

PLAIN = str.maketrans({"\u207b": "-", "\u00b2": "2", "\u00b9": "1", **dict.fromkeys(" ^*.\u00b7")})
SHORT = {"squared": "2", "per": "/", r"met(er|re)(s(?!-2))?": "m", r"radian(s(?!-1))?": "rad", r"sec(ond)?s?": "s"}
"""Words in the name of a unit, once its blanks are gone, and the short ones."""


def check_inertial_header(path: Path, names: list[str]) -> None:
    """Check the names of the columns, the stamp's first, as far as they say what the columns hold; those that say
    nothing are taken for the layout's. Raises SequenceError for another order or unit."""
    layout = [(kind, axis) for kind in (RATE, FORCE) for axis in "xyz"]
    if names and (unit := _unit_of_stamps(names[0])) != "ns":
        raise SequenceError(
            f"{path}: expected stamps in ns, got {unit}, by the name {names[0]!r:.60}; convert them, and correct it"
        )
    for column, (name, (kind, axis)) in enumerate(zip(names[1:], layout, strict=False), start=2):
        words, unit = _parts(name)
        held = [one for one, known in WORDS.items() if known & set(words)]
        axes = [word for word in words if word in ("x", "y", "z")]
        after = words[words.index(axes[-1]) + 1 :][:1] if axes else []
        other = held and (kind not in held or axes[-1:] not in ([], [axis]))
        if other or _unit(unit) not in UNITS[kind] or any(map(OTHER_UNITS.fullmatch, after)):
            raise SequenceError(
                f"{path}: expected in column {column} the {axis} of the {kind}, as in the layout, which has the rate "
                f"before the force, got {name!r:.60}; reorder or convert the columns, and correct their names"
            )


def _unit_of_stamps(name: str) -> str:
    """Unit of stamps by the name of their column: that in brackets, whatever else is there, as in `[ns] (UTC)`, or its
    last word; ns where it says none."""
    name = name.translate(MICRO).lower()
    if NANO.search(name):
        return "ns"
    brackets = [re.findall(r"[a-z]+", text) for text in re.findall(BRACKET, name)]
    said = [word for words in brackets for word in ("".join(words), *words)]
    last = re.findall(r"[a-z]+|[0-9]+", re.sub(BRACKET, " ", name))[-1:]
    units = {**{word: repr(word) for word in OTHER_TIMES}, **UNIT_WORDS}
    known = [units[word] for word in said if word in units] or [UNIT_WORDS[word] for word in last if word in UNIT_WORDS]
    return "ns" if "ns" in known or not known else known[0]


def _parts(name: str) -> tuple[list[str], str]:
    """Lower-case words of a column's name, `gx` and `accx` as two, and its unit in brackets; a number there counts the
    axes, as in `gyro_rad[0]`."""
    bracket = re.search(r"[\[(]([^\])]*)[\])]\s*$", name)
    words = re.findall(r"[a-z]+|[0-9]+", (name[: bracket.start()] if bracket else name).lower())
    known = "|".join(sorted(WORDS[RATE] | WORDS[FORCE], key=len, reverse=True))
    split = [word for one in words for word in re.sub(rf"^({known})([xyz])$", r"\1 \2", one).split()]
    if bracket and bracket[1] in ("0", "1", "2"):
        return [*split, "xyz"[int(bracket[1])]], ""
    return split, bracket[1] if bracket else ""


def _unit(text: str) -> str:
    """A unit in short words, without blanks and signs of powers and products.

    >>> [_unit(text) for text in ("rad s^-1", "radians/sec", "meters per second squared")]
    ['rads-1', 'rad/s', 'm/s2']
    """
    unit = text.lower().translate(PLAIN)
    for word, short in SHORT.items():
        unit = re.sub(word, short, unit)
    return unit
