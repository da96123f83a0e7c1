"""Findings of a diagnosis of the machine, one for each thing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from oysterbench.core.errors import OysterbenchError

State = Literal["ok", "poor", "missing", "broken"]
"""poor: it works, but not well; missing: it is optional and not there; broken: it is set or installed, and does not
work."""


@dataclass(frozen=True)
class Finding:
    """One finding. section: what it belongs to; detail: what it is, or what is wrong; advice: what to type or do."""

    section: str
    name: str
    state: State
    detail: str
    advice: str = ""


def broken_by(section: str, name: str, error: OysterbenchError | OSError, advice: str = "") -> Finding:
    """Finding of something broken, with the message of an error as its detail."""
    return Finding(section, name, "broken", " ".join(str(error).split()), advice)


def in_bytes(size: float) -> str:
    """A number of bytes as text, in MB or GB.

    >>> in_bytes(58e6), in_bytes(2.34e9), in_bytes(0)
    ('58 MB', '2.3 GB', '0 MB')
    """
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"
