"""Names: which are plain, and suggestions for those that were asked for but do not exist."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

FEW = 10
"""Up to this many known names are all listed where an unknown one was asked for."""

PLAIN = "letters, digits, '-' and '_' (a to z, no accents)"
"""What plain names are made of, in words."""


def is_plain(name: str) -> bool:
    """Whether a name is made of letters, digits, '-' and '_', so that as a file's it stays in the file's folder.

    >>> is_plain("mini-01"), is_plain("../mini-01"), is_plain("récif"), is_plain("")
    (True, False, False, False)
    """
    return name.isascii() and name.replace("-", "a").replace("_", "a").isalnum()


def instead(name: str, known: Iterable[str], listed_by: str) -> str:
    """List the known names if they are few; otherwise suggest similar ones, and the command that lists them all.

    >>> instead("calmm", ["calm", "rough"], "oysterbench splits sea")
    'it has calm, rough'
    >>> instead("calmm", ["calm", *(f"rough-{k}" for k in range(10))], "oysterbench splits sea")
    'did you mean calm? `oysterbench splits sea` lists all 11'
    """
    names = list(known)
    if len(names) <= FEW:
        return f"it has {', '.join(names) or 'none'}"
    return f"{did_you_mean(nearest(name, names))}`{listed_by}` lists all {len(names)}"


def nearest(name: str, known: Iterable[str]) -> list[str]:
    """At most four known names that `name` may have been meant to be, the likeliest first.

    >>> nearest("waves-4", ["calm", "waves-1", "wave"])
    ['waves-1', 'wave']
    """
    return difflib.get_close_matches(name, list(known), n=4, cutoff=0.6)


def listed(names: Iterable[str], most: int = FEW) -> str:
    """Join names for a sentence: the first few, at most `most`, and how many more there are.

    >>> listed(["calm", "rough"]), listed(map(str, range(12)))
    ('calm, rough', '0, 1, 2, 3, 4, 5, 6, 7, 8, 9 and 2 more')
    """
    each = list(names)
    more = len(each) - most
    return (", ".join(each[:most]) + (f" and {more} more" if more > 0 else "")) or "none"


def natural_key(name: str) -> list[str | int]:
    """What names are sorted by, so that numbers in them are in order whether or not they are filled up with zeros."""
    return [int(part) if k % 2 else part for k, part in enumerate(re.split(r"(\d+)", name))]


def counted(number: int, noun: str) -> str:
    """A number of things, whose noun is given in the singular.

    >>> counted(1, "file"), counted(2, "file")
    ('1 file', '2 files')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def did_you_mean(names: Iterable[str]) -> str:
    """Question that suggests names, to precede further advice; empty without names.

    >>> did_you_mean(["calm", "wave"])
    'did you mean calm or wave? '
    """
    meant = " or ".join(names)
    return f"did you mean {meant}? " if meant else ""
