"""Results that a user names: files, folders with a results.json, and what a leaderboard knows by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from oysterbench.core.errors import ResultError
from oysterbench.results.records import ResultRecord, comparable_key, method_key, read_results

Finder = Callable[[str], "list[ResultRecord] | None"]
"""Returns the records for a name that is not a file; None if it knows no such name."""


def named_results(names: Iterable[str], find: Finder | None = None) -> list[ResultRecord]:
    """Read the records of files, or of folders that hold results.json, each given as PATH or LABEL=PATH, or of
    anything else that `find` knows by name.

    A label replaces the method's name, or is prepended to it if the file holds several methods. Of what `find` knows,
    only records of the tracks and splits of the files are returned, if there are any. Raises ResultError where two
    different records claim to be the same run of one method.
    """
    sources: dict[tuple[str, ...], tuple[str, ResultRecord]] = {}
    given: list[tuple[str, Path, bool, list[ResultRecord]]] = []
    for name in names:
        label, rest = _labelled(name, find)
        path = Path(rest)
        known = find(rest) if find is not None and not path.exists() else None
        found = read_results(path / "results.json" if path.is_dir() else path) if known is None else known
        if not found:
            raise ResultError(f"{path}: holds no result; expected what `oysterbench eval` writes")
        given.append((label, path, known is None, found))
    own = {(record.track, record.split) for _, _, is_file, found in given if is_file for record in found}
    for label, path, is_file, found in given:
        if not is_file:
            found = [record for record in found if (record.track, record.split) in own] or found
        methods = {record.method for record in found}
        for record in found:
            if label:
                record = replace(record, method=label if len(methods) == 1 else f"{label} {record.method}")
            key = (*comparable_key(record), *method_key(record), record.sequence, str(record.run))
            other = sources.setdefault(key, (str(path), record))
            if replace(other[1], created=record.created, hardware=record.hardware) != record:
                raise ResultError(
                    f"{other[0]} and {path}: both hold run {record.run} of {record.method} on {record.sequence}, with "
                    f"different numbers; tell them apart by labels, e.g. `oysterbench compare A={other[0]} B={path}`"
                )
    return [record for _, record in sources.values()]


def _labelled(name: str, find: Finder | None) -> tuple[str, str]:
    """Label and name of NAME or LABEL=NAME, where NAME is a path or known to `find`: both may contain "=", as names of
    methods with options do. The first reading is meant in which there is such a path or, without any, in which such a
    NAME is known; if there is none, the first whose label does not end within the brackets of options."""
    if Path(name).exists():
        return "", name
    parts = name.split("=")
    splits = [("=".join(parts[:k]), "=".join(parts[k:])) for k in range(1, len(parts)) if any(parts[:k])]
    readings = [("", name), *splits]
    likely = [one for one in splits if one[0].count("[") == one[0].count("]")]
    # Files first: what `find` looks names up in may take a while, or not be there, and is often not meant.
    file = next((one for one in readings if Path(one[1]).exists()), None)
    if file is not None or not splits:
        return file or readings[0]
    return next((one for one in readings if _knows(find, one[1])), (likely or readings)[0])


def _knows(find: Finder | None, name: str) -> bool:
    """Whether `find` has records for a name."""
    try:
        return find is not None and find(name) is not None
    except ResultError:
        return False
