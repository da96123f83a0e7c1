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

NANO_WORDS = {word for word, unit in UNIT_WORDS.items() if unit == "ns"} | {"nano"}
CLOCKS = {"utc", "unix", "posix", "epoch", "ros", "tai", "gps", "ptp", "clock", "time", "since", "in", "int", "uint"}
CLOCK_NUMBERS = {"64", "1970"}
"""What else may be in brackets after the name of stamps in ns: their clock, its start, and their type."""
NANO = re.compile(r"(1e|10)-0?9s(ec(ond)?s?)?|s(ec(ond)?s?)?(1e|10)-?0?9")
"""Nanoseconds as a power of ten of seconds, as `_is_nano` writes them."""
OTHER_TIMES = {
    *("tick", "ticks", "count", "counts", "cycles", "frames", "samples", "ps", "picoseconds"),
    *("min", "mins", "minute", "minutes", "h", "hr", "hrs", "hour", "hours", "day", "days", "week", "weeks"),
}
"""Words of units in the name itself, but for `UNIT_WORDS`."""
BRACKET = r"[\[(]([^\])]*)[\])]"

PLAIN = str.maketrans({"\u207b": "-", "\u00b2": "2", "\u00b9": "1", "\u2079": "9", **dict.fromkeys(" ^*.\u00b7")})
SHORT = {"squared": "2", "per": "/", r"met(er|re)(s(?!-2))?": "m", r"radian(s(?!-1))?": "rad", r"sec(ond)?s?": "s"}
"""Words in the name of a unit, once its blanks are gone, and the short ones."""


def check_inertial_header(path: Path, names: list[str]) -> None:
    """Check the names of the columns, the stamp's first, as far as they say what the columns hold; those that say
    nothing are taken for the layout's. Raises SequenceError for another order or unit."""
    layout = [(kind, axis) for kind in (RATE, FORCE) for axis in "xyz"]
    if names and (unit := _unit_of_stamps(names[0])) != "ns":
        raise SequenceError(
            f"{path}: expected stamps in ns, got {unit}, by the name {names[0]!r:.60}; convert them, and name them "
            "`timestamp [ns]`"
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
    """Unit of stamps by the name of their column: ns where all in brackets is known to go with it and no word beside
    them is another unit; else that unit, or what is not known."""
    name = name.translate(MICRO)
    for text in re.findall(BRACKET, name):
        if not _is_nano(text):
            words = re.findall(r"[a-z]+", text.lower())
            said = [UNIT_WORDS[word] for word in ("".join(words), *words) if word in UNIT_WORDS]
            return next((unit for unit in said if unit != "ns"), repr(text.strip()))
    words = re.findall(r"[a-z]+", re.sub(BRACKET, " ", name).lower())
    units = {**UNIT_WORDS, **{word: repr(word) for word in OTHER_TIMES}}
    return next((units[word] for word in words if units.get(word, "ns") != "ns"), "ns")


def _is_nano(text: str) -> bool:
    """Whether what is in brackets says nothing but nanoseconds, and what clock they are of.

    >>> [_is_nano(text) for text in ("ns since 1970", "UTC", "10^-9 s", "nano seconds", "100 ns", "index")]
    [True, True, True, True, False, False]
    """
    words, numbers = re.findall(r"[a-z]+", text.lower()), re.findall(r"[0-9.]+", text)
    squeezed = text.lower().translate(PLAIN)
    if squeezed in NANO_WORDS or ("." not in text and NANO.fullmatch(squeezed)):
        return True
    return set(words) <= NANO_WORDS | CLOCKS and set(numbers) <= CLOCK_NUMBERS


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
