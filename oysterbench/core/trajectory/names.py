"""Names of columns: their words, and what those say by themselves of a pose, a time or a covariance."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

QUATERNION_WORDS = {"q", "quat", "quaternion", "orientation", "rotation", "rot", "attitude"}
POSITION_WORDS = {"p", "pos", "position", "t", "trans", "translation", "location"}
TIME_WORDS = {"t", "ts", "time", "times", "timestamp", "timestamps", "stamp", "stamps"}
STAMP_WORDS = {"stamp", "stamps", "timestamp", "timestamps"}
UNIT_WORDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "usecs", "micros", "microsec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), "ns"),
}
MICRO = str.maketrans(dict.fromkeys("\u00b5\u03bc", "u"))
"""The micro sign and the Greek letter, both of which are in use, and how units are spelled without them."""
LENGTH_WORDS = {
    **dict.fromkeys(("", "m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
}
OTHER_LENGTHS = {"um", "cm", "dm", "km", "ft", "inch"} | {
    word
    for one in ("centimeter", "centimetre", "decimeter", "decimetre", "kilometer", "kilometre")
    for word in (one, f"{one}s")
}
"""Words of units that positions are not read in, so that a name that ends in one is known to be that of a position."""
COVARIANCE_WORDS = {"cov", "covariance", "covariances"}
COVARIANCE_AXES = {name: k // 2 for k, name in enumerate(("x", "px", "y", "py", "z", "pz"))} | {
    f"{prefix}{axis}": 3 + k for prefix in ("r", "rot") for k, axis in enumerate("xyz")
}

Prefix = tuple[str, ...]
"""Words of a column's name that say whose it is: those of `vio_pos_x` and `vio.orientation.w` are the same."""


def words_of(name: str) -> tuple[list[str], str]:
    """Lower-case words of a column's name, and its unit, if given in brackets or as the last word."""
    name = name.translate(MICRO)
    bracket = re.search(r"[\[(]\s*([a-zA-Z]*)\s*[\])]\s*$", name)
    words = re.findall(r"[a-z]+|[0-9]+", (name[: bracket.start()] if bracket else name).lower())
    if bracket:
        return words, bracket.group(1).lower()
    length = len(words) > 1 and (words[-1] in LENGTH_WORDS or words[-1] in OTHER_LENGTHS)
    return (words[:-1], words[-1]) if length else (words, "")


class Role(NamedTuple):
    """What a column's words say of a pose.

    whose:  words that say whose number it is
    role:   `px` to `pz` or `qx` to `qw`
    word:   what calls it a position or an attitude
    before: how many of `whose` stand before that word
    """

    whose: Prefix
    role: str
    word: str
    before: int


def role_of(words: list[str]) -> Role | None:
    """Whose number a column's words name, and which of a pose; None where it is none."""
    if not words:
        return None
    *before, last = words
    if re.fullmatch(r"q[xyzw]|[pt][xyz]", last):
        before, last = [*before, last[0]], last[1]
    if last not in ("x", "y", "z", "w"):
        return None
    attitudes = [k for k, word in enumerate(before) if word in QUATERNION_WORDS]
    # Beside words of an attitude, which may be of the topic, a letter may be of a frame: q_T_x.
    positions = [
        k for k, word in enumerate(before) if word in POSITION_WORDS and last != "w" and (word[1:] or not attitudes)
    ]
    if attitudes or positions:
        k = max(attitudes + positions)
        whose = tuple(word for word in before[:k] if word not in QUATERNION_WORDS | POSITION_WORDS)
        return Role((*whose, *before[k + 1 :]), f"{'p' if k in positions else 'q'}{last}", before[k], len(whose))
    if before[-1:] == ["pose"] and last != "w":
        return Role(tuple(before[:-1]), f"p{last}", "pose", len(before) - 1)
    return None if before else Role((), "qw" if last == "w" else f"p{last}", "", 0)


def time_words(words: list[str]) -> tuple[Prefix, tuple[str, ...]] | None:
    """Topic and other words of a name that is that of a time: `t`, `timestamp_ns`, `field.header.stamp`, which have no
    topic, and `/vio/header/stamp`; None for others."""
    core = [word for word in words if word not in UNIT_WORDS and word not in ("field", "header")]
    if len(core) == 1 and core[0] in TIME_WORDS:
        return (), tuple(words)
    header = next((k for k in range(len(words)) if words[k : k + 2] == ["header", "stamp"]), None)
    if header is None or not UNIT_WORDS.keys() >= set(words[header + 2 :]):
        return None
    return topic_of(words[:header]), tuple(words[header:])


def topic_of(words: Iterable[str]) -> Prefix:
    """Words of a name without those of messages: the stamp of a message and its position begin with the same."""
    return tuple(word for word in words if word not in ("field", "pose"))


def covariance_cell(words: list[str]) -> tuple[int, int] | None:
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


def time_unit_of(words: tuple[str, ...], unit: str) -> str | None:
    """Unit of stamps by the words of their name and what it has in brackets; None where they do not say."""
    spelled = next((UNIT_WORDS[word] for word in words if word in UNIT_WORDS), None)
    return UNIT_WORDS.get(unit, spelled)
