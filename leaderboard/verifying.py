"""Checks of a board's files: their bytes against their names, and their contents against what this version knows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench_leaderboard.curves import FORMAT as CURVES
from oysterbench_leaderboard.store import KINDS, RecordStore


@dataclass(frozen=True)
class Verified:
    """Outcome of a check. checked: kind -> number of files; problems: file, relative to the folder -> what is wrong."""

    checked: dict[str, int]
    problems: dict[str, str]


def verify(store: RecordStore) -> Verified:
    """Read every file of a store completely, and check that the curves that records name exist."""
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
    return Verified(checked, problems)


def _check(store: RecordStore, kind: str, name: str, known: dict[str, set[str]]) -> None:
    if kind == "changes":
        store.status_change(name)
        return
    if kind == "curves":
        _check_curves(store.curves(name))
        return
    record = store.record(name)
    if record.curves and record.curves not in known["curves"]:
        raise ResultError(f"the curves that it names, {record.curves[:12]}, are missing")


def _check_curves(document: dict[str, Any]) -> None:
    if document.keys() != {"format", "align", "sequences"} or document["format"] != CURVES:
        raise ResultError(f"expected curves of the format {CURVES!r}")
    for sequence, curve in document["sequences"].items():
        if curve.keys() != {"run", "t_s", "truth", "path", "error_m"}:
            raise ResultError(f"curve of {sequence}: expected run, t_s, truth, path and error_m")
        if len({len(curve[key]) for key in ("t_s", "truth", "path", "error_m")}) > 1:
            raise ResultError(f"curve of {sequence}: expected lists of one length")
