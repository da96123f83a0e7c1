"""A table of inertial samples in EuRoC layout: whether its columns and stamps are those of the layout."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import accumulate, islice
from pathlib import Path
from statistics import median
from typing import NamedTuple

from oysterbench.core.errors import SequenceError
from oysterbench.core.trajectory.names import MICRO, UNIT_WORDS
from oysterbench.core.trajectory.stamps import SHIFTS

SEPARATORS = (",", ";", "\t")
"""Marks between the fields of a row: a comma in the layout; semicolons and tabs as spreadsheets write them."""

RATE, FORCE = "angular rate in rad/s", "specific force in m/s^2"
WORDS = {
    RATE: {"w", "g", "gyr", "gyro", "gyros", "gyroscope", "gyroscopes", "omega", "ang", "angular", "rotation"},
    FORCE: {"a", "f", "acc", "accl", "accel", "acceleration", "accelerations", "accelerometer", "linear", "force"},
}
"""Words in the names of columns, by what they hold."""

OTHER = "another quantity"
"""What a velocity beside a word of forces is, and an acceleration beside one of rates: `linear_velocity_x`."""
TURNS = {"roll": "x", "pitch": "y", "yaw": "z"}
"""Axes of angular rates by the names of rotations."""
SPEEDS = {"rate", "rates", "speed"}
"""Words that make an angular rate beside an axis: `roll_rate`, `x_rate`."""
BODY_RATES = dict(zip("pqr", "xyz", strict=True))
"""Rates about the axes as aviation calls them, whole names of columns."""

LAYOUT = [(kind, axis) for kind in (RATE, FORCE) for axis in "xyz"]
"""What the columns after the stamp hold."""

UNITS = {RATE: {"", "rad/s", "rads-1", "1/s", "s-1"}, FORCE: {"", "m/s2", "ms-2", "m/s/s"}}
"""Units of each, as `_unit` writes them."""

OTHER_UNITS = re.compile(r"deg.*|m?dps|rpm|mrad(/s)?|[mu]?g|[cm]m(s|ps)?")
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

PLAIN = str.maketrans(
    {"\u00b0": "deg", "\u207b": "-", "\u00b2": "2", "\u00b9": "1", "\u2079": "9", **dict.fromkeys(" ^*.\u00b7")}
)
SHORT = {"squared": "2", "per": "/", r"met(er|re)(s(?!-2))?": "m", r"radian(s(?!-1))?": "rad", r"sec(ond)?s?": "s"}
"""Words in the name of a unit, once its blanks are gone, and the short ones."""


class Header(NamedTuple):
    """A line above the rows of a table, with a field for each column: names, units, groups of axes, or a remark."""

    line: int
    fields: list[str]


class Said(NamedTuple):
    """What a field says of its column: kinds of quantity, the last axis, and units. Empty where it says nothing."""

    kinds: set[str]
    axis: str
    units: set[str]


def headers_above(lines: Iterable[str]) -> list[Header]:
    """Lines above the rows of a table that have a name for each column of the layout, or one for each sensor. Fields
    left empty in a line of groups are of the group.

    >>> headers_above(["# site A, 2 m", "#t,gyro,,,acc,,", "#[ns, UTC],x,y,z,x,y,z", "0,0,0,0,0,0,9.8"])[0]
    Header(line=2, fields=['t', 'gyro', 'gyro', 'gyro', 'acc', 'acc', 'acc'])
    """
    found = []
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if text and not text.startswith("#") and not (number == 1 and text[0].isalpha()):
            break
        # At none in brackets, as in [ns, UTC], where another mark than between the names may be.
        split = (re.split(mark + r"(?![^\[(]*[\])])", text.lstrip("# ")) for mark in SEPARATORS)
        stamp, *fields = (field.strip(' "') for field in max(split, key=len))
        if len([*filter(None, fields)]) > 1:
            fields = [*accumulate(fields, _of_group)]
        names = [stamp, *fields]
        if len(names) <= len(LAYOUT):
            names = _names_between(text) or _of_two_groups(names)
        if names:
            found.append(Header(number, names))
    return found


def _names_between(text: str) -> list[str]:
    """Names of the columns in a line with blanks or | between them, each with an axis. Empty in any other line."""
    text = re.sub(r"\s+(?=[\[(])", "", text.lstrip("# "))
    names = [name.strip() for name in (text.split("|") if "|" in text else text.split())]
    return names if len(names) > len(LAYOUT) and all(_said(name).axis for name in names[1 : 1 + len(LAYOUT)]) else []


def _of_two_groups(names: Sequence[str]) -> list[str]:
    """Names of the columns in a line that has the time and a word for each sensor, as in `t, gyro, acc(x,y,z)`; what
    is in brackets is left out. Empty in any other line, as a remark."""
    stamp, *groups = (re.sub(BRACKET, "", name).strip().lower() for name in names)
    if len(groups) != 2 or not re.search(r"^t$|time|stamp", stamp):
        return []
    alike = all(group.isalpha() and len(_said(group).kinds) == 1 for group in groups)
    return [names[0], *(group for group in groups for _ in "xyz")] if alike else []


def _of_group(group: str, field: str) -> str:
    return field or group


def check_inertial_table(path: Path, above: Sequence[Header], stamps_ns: Iterable[int]) -> None:
    """Check the lines above the rows, as far as they say what the columns hold, and the rate of the samples. Raises
    SequenceError for another order or unit, and for stamps that cannot be ns, whatever their name. A line that says
    little, as a remark may, counts only where there is none of names, groups or units."""
    for header in [header for header in above if _is_of_columns(header)] or above:
        _check_header(path, header)
    _check_rate(path, list(islice(stamps_ns, RATED)))


def _is_of_columns(header: Header) -> bool:
    """Whether a line says the kind of the columns of a sensor, or the axis or the unit of each."""
    said = [_said(field) for field in header.fields[1 : 1 + len(LAYOUT)]]
    sensors = (said[:3], said[3:])
    return any(_kinds(of) or all(one.axis for one in of) or all(one.units for one in of) for of in sensors)


def _kinds(columns: Sequence[Said]) -> set[str]:
    """Kinds of quantity that all of some columns have."""
    return set.intersection(*(one.kinds for one in columns))


def _said(field: str) -> Said:
    """What a name or a unit says.

    >>> [_said(text).units for text in ("w_x [rad/s]", "[LSB]", "deg/s", "[-]")]
    [{'rad/s'}, {'lsb'}, {'deg/s'}, set()]
    """
    if _is_plain(field):
        return Said(set(), "", set())
    if axis := BODY_RATES.get(field.strip().lower()):
        return Said({RATE}, axis, set())
    words, unit = _parts(f"[{field}]" if _is_unit(field) else field)
    axes = [word for word in words if word in ("x", "y", "z")]
    # A letter is one of a quantity beside an axis or a number, or by itself, but not in `site A`.
    numbered = axes or field in words or {*words} & {*"0123"}
    kinds = {kind for kind, known in WORDS.items() if any(word in known for word in words if numbered or len(word) > 1)}
    if re.search("linear velocity|ang(ular)? acceleration", " ".join(words)):
        kinds = {OTHER}
    turns = [word for word in words if word in TURNS and not axes]
    if (axes or turns) and not kinds and SPEEDS & {*words}:
        kinds = {RATE}
    if RATE in kinds:
        axes = [*axes, *turns]
    last = [place for place, word in enumerate(words) if axes and word in {*axes, *SPEEDS}]
    after = words[last[-1] + 1 :][:1] if last else []
    # Behind the last name may be those of all, (rad/s, m/s^2), and behind any its axes, [m/s^2, FLU].
    units = {_unit(one) for one in re.split("[,;]", unit)} if unit else {*filter(OTHER_UNITS.fullmatch, after)}
    return Said(kinds, TURNS.get(axes[-1], axes[-1]) if axes else "", units)


def _is_plain(field: str) -> bool:
    """Whether a field is a number, a dash, or a type or format of numbers."""
    return bool(re.fullmatch(r"-?|\d+|u?int\d*|float\d*|double|[<>=]?[iuf]\d+|%.*", field.strip("[]() ").lower()))


def _is_unit(field: str) -> bool:
    """Whether a field is a unit alone, without brackets."""
    known = {*UNIT_WORDS, *UNITS[RATE], *UNITS[FORCE]}
    return field.lower() in known or _unit(field) in known or bool(OTHER_UNITS.fullmatch(_unit(field)))


def _check_header(path: Path, header: Header) -> None:
    stamp, *fields = header.fields
    said = [_said(field) for field in fields]
    if any(any(one) for one in said[: len(LAYOUT)]) and (unit := _unit_of_stamps(stamp)) != "ns":
        raise SequenceError(
            f"{path}: expected stamps in ns, got {unit}, by the name {stamp!r:.60} in line {header.line}; convert "
            "them and name them `timestamp [ns]` or, if the line is a remark, remove it"
        )
    more = said[len(LAYOUT) :]
    further = {kind for three in zip(more, more[1:], more[2:], strict=False) for kind in _kinds(three)}
    for column, (field, one, (kind, axis)) in enumerate(zip(fields, said, LAYOUT, strict=False), start=2):
        if _contradicts(one, kind, axis) or (kind in further and not (one.kinds or one.units)):
            raise SequenceError(
                f"{path}: expected in column {column} the {axis} of the {kind}, as in the layout, which has the rate "
                f"before the force, got {field!r:.60} in line {header.line}; reorder or convert the columns and "
                "correct their names or, if the line is a remark, remove it"
            )


def _contradicts(said: Said, kind: str, axis: str) -> bool:
    unknown = said.units - UNITS[RATE] - UNITS[FORCE]
    return bool(
        (said.kinds and kind not in said.kinds)
        or (said.axis and said.axis != axis)
        or (said.units and not said.units & UNITS[kind])
        or any(not unit.isalpha() or OTHER_UNITS.fullmatch(unit) for unit in unknown)
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
    """Lower-case words of a column's name, `gx`, `xacc` and `AccelX` as two, and its unit in brackets; a number there
    counts the axes, as in `gyro_rad[0]`."""
    while (frame := re.search(BRACKET + r"\s*$", name)) and frame[1].strip().lower() in FRAMES:
        name = name[: frame.start()]
    bracket = re.search(r"[\[(]([^\])]*)[\])]\s*$", name)
    parts = re.sub("(?<=[a-z]{2})(?=[A-Z])", " ", name[: bracket.start()] if bracket else name)
    words = re.findall(r"(?:roll|pitch|yaw)(?=rate|speed)|[a-z]+|[0-9]+", parts.lower())
    known = "|".join(sorted(WORDS[RATE] | WORDS[FORCE], key=len, reverse=True))
    pattern = rf"^({known})([xyz])$|^([xyz])({known})$"
    split = [word for one in words for word in re.sub(pattern, r"\1\4 \2\3", one).split()]
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
