"""A table of inertial samples in EuRoC layout: whether its columns and stamps are those of the layout."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import accumulate, islice, zip_longest
from pathlib import Path
from statistics import median

from oysterbench.core.errors import SequenceError
from oysterbench.core.trajectory.names import MICRO, TIME_WORDS, UNIT_WORDS, words_of
from oysterbench.core.trajectory.stamps import SHIFTS

SEPARATORS = (",", ";", "\t")
"""Marks between the fields of a row: a comma in the layout; semicolons and tabs as spreadsheets write them."""

RATE, FORCE = "angular rate in rad/s", "specific force in m/s^2"
WORDS = {
    RATE: {"w", "g", "gyr", "gyro", "gyroscope", "omega", "angular"},
    FORCE: {"a", "f", "acc", "accel", "acceleration", "accelerometer", "linear", "force"},
}
"""Words in the names of columns, by what they hold."""

HELD = WORDS[RATE] | WORDS[FORCE]
LEAST_SAID = 4
"""Least number of the seven columns that the line of their names says something of; a remark says less."""

UNITS = {RATE: {"", "rad/s", "rads-1", "1/s", "s-1"}, FORCE: {"", "m/s2", "ms-2", "m/s/s"}}
"""Units of each, as `_unit` writes them."""

OTHER_UNITS = re.compile(r"deg.*|m?dps|rpm|mrad|[mu]?g|[cm]m(s|ps)?")
"""First word of the units that stand after the axis in the names of some tables, as in `gyro_x_deg_per_s`."""

LEAST_HZ, MOST_HZ = 1.0, 5000.0
"""Rates of inertial samples. Some units are faster, up to 32 kHz, but so seem those at 5 Hz or more in us."""
RATED = 1000
"""Number of samples, the first of a file, whose rate is checked."""
STEPS = 64
"""Most steps from one sample to another over which a rate is measured: more than there are in a burst."""
YEAR_2000_NS = 946_684_800 * 10**9
"""Since 1970. Stamps above it are in no larger unit, not even in the 100 ns of Windows since the year 1601 or 1."""

CLOCKS = {"utc", "unix", "posix", "epoch", "ros", "tai", "gps", "ptp", "clock", "time", "since", "in", "int", "uint"}
CLOCK_NUMBERS = {"64", "1970"}
"""What may be in brackets after the name of stamps and says no unit: their clock, its start, and their type."""
NANO = re.compile(r"(1e|10)-0?9s(ec(ond)?s?)?|s(ec(ond)?s?)?(1e|10)-?0?9")
"""Nanoseconds as a power of ten of seconds, as `_plain_nano` writes them."""
MULTIPLE = re.compile(r"(?<![a-z0-9.])(?!(1|1970)\s*n)[\d.]+\s*(ns|nano)|\bns\s*[*/x\u00d7]\s*\d", re.IGNORECASE)
"""A number of nanoseconds, or a part of one, as the unit."""
OTHER_TIMES = {
    *("tick", "ticks", "count", "counts", "cycles", "frames", "samples", "ps", "picoseconds"),
    *("min", "mins", "minute", "minutes", "h", "hr", "hrs", "hour", "hours", "day", "days", "week", "weeks"),
}
"""Words of units where the name has none of `UNIT_WORDS`."""
FRAMES = {"body", "imu", "sensor", "flu", "frd", "rfu", "fwd", "ned", "enu", "nwu"}
"""What may be in brackets after the name of an axis and says no unit: its frame."""
BRACKET = r"[\[(]([^\[\]()]*)[\])]"

PLAIN = str.maketrans({"\u207b": "-", "\u00b2": "2", "\u00b9": "1", "\u2079": "9", **dict.fromkeys(" ^*.\u00b7")})
SHORT = {"squared": "2", "per": "/", r"met(er|re)(s(?!-2))?": "m", r"radian(s(?!-1))?": "rad", r"sec(ond)?s?": "s"}
"""Words in the name of a unit, once its blanks are gone, and the short ones."""


def names_above(lines: Iterable[str]) -> list[str]:
    """Names of the columns in the lines of a table: the line above its rows that says most of what they hold, with that
    of the groups of axes, if there is one; empty where none says it of most columns. Units in a line of their own are
    added to the names.

    >>> names_above(["# of 2024, gyro, accel, IMU, site A, B, C", "#t,wx,wy,wz,ax,ay,az", "#[ns],,,,[g],[g],[g]"])[3:5]
    ['wz', 'ax [g]']
    >>> names_above(["#,gyro,,,acc,,", "#timestamp,x,y,z,x,y,z"])[3:5]
    ['gyro z', 'acc x']
    """
    found: list[list[str]] = []
    for number, line in enumerate(lines):
        text = line.strip()
        if text and not text.startswith("#") and not (number == 0 and text[0].isalpha()):
            break
        # At none in brackets, as in [ns, UTC], where another mark than between the names may be.
        split = (re.split(mark + r"(?![^\[(]*[\])])", text.lstrip("# ")) for mark in SEPARATORS)
        found.append([field.strip() for field in max(split, key=len)])
    found = [fields for fields in found if len(fields) > 6]
    units = next((fields for fields in found if all(map(_is_unit, fields[:7]))), [])
    rest = [list(accumulate(fields, _or_last)) for fields in found if fields is not units]
    names = max(rest, key=_said, default=[])
    groups = max(rest, key=_held, default=[])
    if _held(groups) >= LEAST_SAID and not _held(names):
        names = [*names[:1], *map(" ".join, zip(groups[1:], names[1:], strict=False))]
    if _said(names) < LEAST_SAID:
        names = [""] * len(units)
    return [
        f"{name} [{unit.strip('[]()')}]" if unit else name for name, unit in zip_longest(names, units, fillvalue="")
    ]


def _or_last(last: str, field: str) -> str:
    """The name of a column: the one left of it where its own is empty, as in ``gyro,,,acc,,``."""
    return field or last


def _said(names: list[str]) -> int:
    """How many of the seven columns a line says something of: a time, a rate or a force, an axis or a unit."""
    parts = [_parts(name) for name in names[1:7]]
    known = [unit or words[-1:] in (["x"], ["y"], ["z"]) or HELD & {*words} for words, unit in parts]
    return sum(map(bool, (*known, names and _is_time(names[0]))))


def _held(names: list[str]) -> int:
    """How many of the six columns a line calls a rate or a force."""
    return sum(bool(HELD & {*_parts(name)[0]}) for name in names[1:7])


def _is_unit(text: str) -> bool:
    """Whether a field is a unit alone, with or without brackets, or empty."""
    unit = text.strip("[]() ")
    known = {*UNIT_WORDS, *UNITS[RATE], *UNITS[FORCE]}
    return unit.lower() in known or _unit(unit) in known or bool(OTHER_UNITS.fullmatch(_unit(unit)))


def check_inertial_table(path: Path, names: list[str], stamps_ns: Iterable[int]) -> None:
    """Check the names of the columns, the stamp's first, as far as they say what the columns hold, and the rate of the
    samples. Raises SequenceError for another order or unit, and for stamps that cannot be ns, whatever their name."""
    _check_names(path, names)
    _check_rate(path, list(islice(stamps_ns, RATED)))


def _is_time(name: str) -> bool:
    words, unit = words_of(name)
    return bool({*words, unit} & {*TIME_WORDS, *UNIT_WORDS})


def _check_names(path: Path, names: list[str]) -> None:
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
        # Behind the last name may be those of all, (rad/s, m/s^2), and behind any its axes, [m/s^2, FLU].
        units = {_unit(one) for one in re.split("[,;]", unit)}
        unknown = [one for one in units - UNITS[RATE] - UNITS[FORCE] if not one.isalpha() or OTHER_UNITS.fullmatch(one)]
        if other or unknown or not units & UNITS[kind] or any(map(OTHER_UNITS.fullmatch, after)):
            raise SequenceError(
                f"{path}: expected in column {column} the {axis} of the {kind}, as in the layout, which has the rate "
                f"before the force, got {name!r:.60}; reorder or convert the columns, and correct their names"
            )


def _check_rate(path: Path, stamps_ns: list[int]) -> None:
    """Refuse samples that are too many in a second for stamps in ns, but not for those in another unit. Those that are
    read in bursts, and stamped then, have their rate over several; a gap is in few of such spans."""
    count = min(STEPS, max(1, (len(stamps_ns) - 1) // 3))
    spans = [after - before for before, after in zip(stamps_ns, stamps_ns[count:], strict=False) if after > before]
    if not spans or min(stamps_ns) >= YEAR_2000_NS:
        return
    rates = {unit: count * 10**9 / (median(spans) * 10**shift) for unit, shift in SHIFTS.items()}
    fits = {unit: rate for unit, rate in rates.items() if LEAST_HZ <= rate <= MOST_HZ}
    if rates["ns"] > MOST_HZ:
        others = " or ".join(f"{rate:.4g} Hz if they are in {unit}" for unit, rate in fits.items())
        raise SequenceError(
            f"{path}: expected inertial samples at up to {MOST_HZ:g} Hz by their stamps in ns, got "
            f"{rates['ns']:.4g} Hz ({others}); convert the stamps to ns or, if they are, write them as ns since 1970, "
            "which no other unit has"
        )


def _unit_of_stamps(name: str) -> str:
    """Unit of stamps by the name of their column: ns where it says so, or says nothing but their clock; else another
    unit, or what is not known.

    >>> [_unit_of_stamps(f"t [{text}]") for text in ("ns since boot", "UTC", "10^-9 s", "nano-seconds", "index", "ms")]
    ['ns', 'ns', 'ns', 'ns', "'index'", 'ms']
    """
    name = re.sub(r"(?i)(nano|micro|milli)[\s_-]+(?=s)", r"\1", name.translate(MICRO))
    brackets, plain = [], name
    while bracket := re.search(BRACKET, plain):  # the innermost, as in [nanoseconds (1e-9 s)]
        brackets.append(_plain_nano(bracket[1]))
        plain = f"{plain[: bracket.start()]} {plain[bracket.end() :]}"
    # Beside a unit by itself in brackets, those beside other words, as (1 us resolution), are not that of the stamps.
    alone = [text for text in brackets if text.strip().lower() in UNIT_WORDS]
    said = [word for text in (*(alone or brackets), plain) for word in re.findall(r"[a-z]+", text.lower())]
    units = {"ns" if word == "nano" else UNIT_WORDS[word] for word in said if word in {*UNIT_WORDS, "nano"}}
    if units - {"ns"}:
        return next(unit for unit in SHIFTS if unit in units)
    if units:
        unknown = [text for text in (*brackets, plain) if MULTIPLE.search(text)]
    else:
        unknown = [text for text in brackets if not _is_clock(text)] + [word for word in said if word in OTHER_TIMES]
    return repr(unknown[0].strip()) if unknown else "ns"


def _plain_nano(text: str) -> str:
    """Text in brackets, `ns` where it is a power of ten of seconds that means it."""
    return "ns" if "." not in text and NANO.fullmatch(text.lower().translate(PLAIN)) else text


def _is_clock(text: str) -> bool:
    words, numbers = re.findall(r"[a-z]+", text.lower()), re.findall(r"[0-9.]+", text)
    return set(words) <= CLOCKS and set(numbers) <= CLOCK_NUMBERS


def _parts(name: str) -> tuple[list[str], str]:
    """Lower-case words of a column's name, `gx` and `accx` as two, and its unit in brackets; a number there counts the
    axes, as in `gyro_rad[0]`."""
    while (frame := re.search(BRACKET + r"\s*$", name)) and frame[1].strip().lower() in FRAMES:
        name = name[: frame.start()]
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
