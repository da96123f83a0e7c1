"""Checks of a board's files: their bytes against their names, and their contents against what this version knows."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.core.text import in_one_line
from oysterbench.hub.canonical import canonical, decode, parse
from oysterbench.results.plausible import check_plausible
from oysterbench_leaderboard.boards.ranking import columns_of
from oysterbench_leaderboard.storage.curves import FORMAT as CURVES
from oysterbench_leaderboard.storage.curves import Curves
from oysterbench_leaderboard.storage.record_summary import read_record
from oysterbench_leaderboard.storage.store import KINDS, RecordStore


@dataclass(frozen=True)
class Verified:
    """Outcome of a check. checked: kind -> number of files; problems: file, relative to the folder -> what is wrong."""

    checked: dict[str, int]
    problems: dict[str, str]


def verify(store: RecordStore) -> Verified:
    """Read every file of a store completely: each must be canonical JSON of its kind, with plausible numbers, and the
    curves and records that a record names must exist."""
    problems: dict[str, str] = {}
    checked = dict.fromkeys(KINDS, 0)
    known = {kind: set(store.names(kind)) for kind in KINDS}
    for kind in KINDS:
        for path in sorted((store.folder / kind).glob("*")) if (store.folder / kind).is_dir() else []:
            where = f"{kind}/{path.name}"
            if path.name == ".gitkeep" or (path.name.startswith(".") and ".json." in path.name):
                continue  # left by a killed writer; readers ignore it
            if path.stem not in known[kind] or path.suffix != ".json":
                problems[where] = "its name is no SHA-256 with .json: it is in no index"
                continue
            checked[kind] += 1
            try:
                _check(store, kind, path.stem, known)
            except OysterbenchError as error:
                problems[where] = str(error)
            except (OSError, ArithmeticError, ValueError, RecursionError) as error:
                problems[where] = f"it cannot be read: {in_one_line(error)}"
    return Verified(checked, problems)


def _check(store: RecordStore, kind: str, name: str, known: dict[str, set[str]]) -> None:
    data = store.data(name, kind)
    if kind == "changes":
        store.status_change(name)
    elif kind == "curves":
        _check_curves(data)
    else:
        _check_record(data, name, known)
    if canonical(parse(data, kind)) != data:
        raise ResultError("expected canonical JSON: keys sorted, each of them once, and no spaces")


def _check_record(data: bytes, name: str, known: dict[str, set[str]]) -> None:
    record = read_record(data, name)
    columns_of(record, name)
    for result in record.results:
        check_plausible(result, f"run {result.run + 1} on {result.sequence}")
    if record.curves and record.curves not in known["curves"]:
        raise ResultError(f"the curves that it names, {record.curves[:12]}, are missing")
    if record.supersedes and record.supersedes not in known["records"]:
        raise ResultError(f"the record that it supersedes, {record.supersedes[:12]}, is missing")


def _check_curves(data: bytes) -> None:
    document = decode(data, Curves, "curves")
    if document.format != CURVES:
        raise ResultError(f"expected curves of the format {CURVES!r}, got {document.format!r:.60}")
    for sequence, curve in document.sequences.items():
        if len({len(curve.t_s), len(curve.truth), len(curve.path), len(curve.error_m)}) > 1:
            raise ResultError(f"curve of {sequence}: expected lists of one length")
