"""What a look at the machine finds, one thing at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from oysterbench.core.errors import OysterbenchError

State = Literal["ok", "poor", "missing", "broken"]
"""poor: it works, and not well; missing: it need not be there; broken: it is set or installed, and does not work."""


@dataclass(frozen=True)
class Finding:
    """One thing. section: what it belongs to; detail: what it is, or what is wrong; advice: what to type or to do."""

    section: str
    name: str
    state: State
    detail: str
    advice: str = ""


def broken_by(section: str, name: str, error: OysterbenchError | OSError, advice: str = "") -> Finding:
    """What an error says of something that is set."""
    return Finding(section, name, "broken", " ".join(str(error).split()), advice)


def in_bytes(size: float) -> str:
    """A number of bytes in words.

    >>> in_bytes(58e6), in_bytes(2.34e9), in_bytes(0)
    ('58 MB', '2.3 GB', '0 MB')
    """
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"
