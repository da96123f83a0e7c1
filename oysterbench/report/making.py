"""Provenance of the numbers of a report: settings, versions and machine, one line each."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from oysterbench.results.machines import machine_of
from oysterbench.results.records import ResultRecord

LONGEST = 600
"""Maximum length of a value, characters; the JSON holds all of it."""
MOST_VALUES = 8
"""Maximum number of different values of one setting; the JSON holds them all."""

Groups = dict[str, dict[str, list[str]]]
"""Heading -> setting -> its distinct values, in the order of the runs."""


def making(records: Sequence[ResultRecord]) -> Groups:
    """Collect everything that the runs record about how they were made: evaluation, methods, machine."""
    found: Groups = {}
    for record in records:
        of_method = record.method
        digest = f", recipe {record.split_digest[:16]}" if record.split_digest else ""
        _add(found, "Evaluation", {"split": record.split + digest, "evaluator": record.evaluator_version})
        _add(found, "Evaluation", record.settings)
        _add(found, f"{of_method}: settings", record.method_settings)
        _add(found, f"{of_method}: settings", {} if record.seed is None else {"seed": record.seed})
        _add(found, f"{of_method}: what it reports", record.info)
        _add(found, "Versions and machine", {"oysterbench": record.oysterbench_version, **record.hardware})
        _add(found, f"{of_method}: run", {"created": record.created, "machine": machine_of(record.hardware)})
    return {heading: {key: _few(values) for key, values in of.items()} for heading, of in found.items() if of}


def scored_when(records: Sequence[ResultRecord]) -> str:
    """Say which methods were scored on how many sequences, by which version and when, with a date per method if they
    differ."""
    dates: dict[str, list[str]] = {}
    for record in records:
        dates.setdefault(record.method, []).append(record.created[:10])
    spans = {method: " to ".join(dict.fromkeys((min(of), max(of)))) for method, of in dates.items()}
    alike = len(set(spans.values())) == 1
    methods = ", ".join(method if alike else f"{method} ({span})" for method, span in spans.items())
    sequences = len({record.sequence for record in records})
    versions = ", ".join(dict.fromkeys(record.oysterbench_version for record in records))
    span = next(iter(spans.values()))
    when = "" if not alike else f" from {span}" if " to " in span else f" on {span}"
    return f"{methods} on {sequences} sequence{'' if sequences == 1 else 's'}, scored by oysterbench {versions}{when}."


def _add(found: Groups, heading: str, values: Mapping[str, Any]) -> None:
    group = found.setdefault(heading, {})
    for key, text in flattened(values):
        if text and text not in group.setdefault(key, []):
            group[key].append(text)


def flattened(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Iterate over keys, with dots for nested mappings, and values as text.

    >>> list(flattened({"a": {"b": 1.5, "c": None}, "d": "x"}))
    [('a.b', '1.5'), ('a.c', 'none'), ('d', 'x')]
    """
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", text_of(value)


def text_of(value: Any) -> str:
    """Text of a value in one line; long ones are cut."""
    if value is None:
        return "none"
    text = value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}\N{HORIZONTAL ELLIPSIS}"


def _few(values: list[str]) -> list[str]:
    more = len(values) - MOST_VALUES
    return values if more <= 0 else [*values[:MOST_VALUES], f"and {more} more"]
