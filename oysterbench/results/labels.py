"""Labels of methods: the name, and of methods that share it, the settings in which they differ."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence

MOST_LISTED = 4
"""Number of settings, or values of one, that a sentence or label names; the rest are only counted."""
LONGEST = 40
"""Number of characters of a setting's value beyond which a label has only a part of it, where values differ."""
AHEAD = 20
"""Number of characters that are kept before those that differ, at most."""


def method_labels(keys: Sequence[tuple[str, str]]) -> dict[tuple[str, str], str]:
    """Label each method with its name and the settings that distinguish it from others of that name.

    keys: (name, settings as JSON) of each
    """
    found: dict[tuple[str, str], str] = {}
    for name, settings in keys:
        others = [json.loads(other) for n, other in keys if n == name]
        own = json.loads(settings)
        absent = object()
        differing = [key for key in own if any(other.get(key, absent) != own[key] for other in others)]
        written = [f"{key} = {_part(own[key], [other[key] for other in others if key in other])}" for key in differing]
        label = name if len(others) == 1 else f"{name} ({few(written) or 'defaults'})"
        same = sum(other == label or other.startswith(f"{label} #") for other in found.values())
        found[name, settings] = f"{label} #{same + 1}" if same else label  # differ in unnamed settings
    return found


def few(values: Sequence[str]) -> str:
    """List the first values, and how many more there are."""
    more = len(values) - MOST_LISTED
    return ", ".join(values) if more <= 0 else f"{', '.join(values[:MOST_LISTED])} and {more} more"


def _part(value: object, values: Iterable[object]) -> str:
    """Write a value of a setting: the part in which it differs from the other values, and all of it where that is not
    enough to tell it from each."""
    texts = {str(each) for each in values}
    if max(map(len, texts)) <= LONGEST:
        return str(value)
    columns = enumerate(zip(*texts, strict=False))
    differ = next((at for at, letters in columns if len(set(letters)) > 1), min(map(len, texts)))
    begin = max(str(value).rfind(" ", 0, differ) + 1, differ - AHEAD) if len(texts) > 1 else 0

    def cut(text: str) -> str:
        rest = text[begin:] if begin > AHEAD else text
        shown = rest if len(rest) <= LONGEST else f"{rest[:LONGEST]}..."
        return shown if rest == text else f"...{shown}"

    return cut(str(value)) if len(set(map(cut, texts))) == len(texts) else str(value)


def names_of_runs(runs: Sequence[tuple[str, str, int]]) -> list[str]:
    """Name of the method of each run, with its number where there are several of a method on a sequence.

    runs: (method, sequence, number from 0) of each

    >>> names_of_runs([("a", "dive", 0), ("a", "dive", 1), ("b", "dive", 0)])
    ['a, run 1', 'a, run 2', 'b']
    """
    several = {(method, sequence) for method, sequence, number in runs if number}
    return [f"{name}, run {number + 1}" if (name, sequence) in several else name for name, sequence, number in runs]
