"""Checks of a board's files: their bytes against their names, and their contents against what this version knows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.core.text import in_one_line
from oysterbench.hub.canonical import canonical, decode, parse
from oysterbench.tracks import TRACKS
from oysterbench_leaderboard.boards.ranking import columns_of
from oysterbench_leaderboard.publishing.contradictions import check_contradictions, check_drawn
from oysterbench_leaderboard.publishing.truths import contradicted, current, held_since, stated_in
from oysterbench_leaderboard.storage.curves import FORMAT as CURVES
from oysterbench_leaderboard.storage.curves import Curve, Curves
from oysterbench_leaderboard.storage.record import Record, check_time
from oysterbench_leaderboard.storage.record_summary import read_record
from oysterbench_leaderboard.storage.store import KINDS, RecordStore

ROUNDED_M = 0.003
"""Greatest difference between the error of a curve's point and the distance of its positions, which are rounded to a
millimetre each."""

CLOCKS_DIFFER = timedelta(days=1)
"""Farthest into the future that the clock of another machine may be."""


@dataclass(frozen=True)
class Verified:
    """Outcome of a check. checked: kind -> number of files; problems: file, relative to the folder -> what is wrong."""

    checked: dict[str, int]
    problems: dict[str, str]


def verify(store: RecordStore) -> Verified:
    """Read every file of a store completely: each must be canonical JSON of its kind, with plausible numbers and parts
    that do not contradict each other, the curves and records that a record names must exist, and the current
    records of a board must be of one ground truth."""
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
            except (OSError, ArithmeticError, ValueError, TypeError, RecursionError) as error:
                problems[where] = f"it cannot be read: {in_one_line(error)}"
    every, changes = stated_in(store)
    for digest, why in contradicted(current(every, changes), lambda: held_since(every, changes)).items():
        problems.setdefault(f"records/{digest}.json", f"{why}: withdraw the one that is wrong")
    return Verified(checked, problems)


def _check(store: RecordStore, kind: str, name: str, known: dict[str, set[str]]) -> None:
    data = store.data(name, kind)
    if kind == "changes":
        store.status_change(name)
    elif kind == "curves":
        _read_curves(data)
    else:
        _check_record(store, data, name, known)
    if canonical(parse(data, kind)) != data:
        raise ResultError("expected canonical JSON: keys sorted, each of them once, and no spaces")


def _check_record(store: RecordStore, data: bytes, name: str, known: dict[str, set[str]]) -> None:
    record = read_record(data, name)
    columns_of(record, name)
    _check_evaluator(record)
    _check_times(record)
    check_contradictions(record)
    if record.supersedes and record.supersedes not in known["records"]:
        raise ResultError(f"the record that it supersedes, {record.supersedes[:12]}, is missing")
    if not record.curves:
        return
    if record.curves not in known["curves"]:
        raise ResultError(f"the curves that it names, {record.curves[:12]}, are missing")
    try:
        curves = _read_curves(store.data(record.curves, "curves"))
    except OysterbenchError as error:
        raise ResultError(f"the curves that it names, {record.curves[:12]}, cannot be used: {error}") from None
    check_drawn(record, curves)


def _check_evaluator(record: Record) -> None:
    """Refuse an evaluator that is neither its track's present one nor an earlier version of it."""
    track = TRACKS.get(record.track, TRACKS["steering"])  # rollouts have a name of their own
    name, _, latest = track.evaluator.rpartition(" ")
    if record.evaluator_version not in [f"{name} {version}" for version in range(1, int(latest) + 1)]:
        expected = f"{name} 1" if latest == "1" else f"{name} 1 to {latest}"
        raise ResultError(f"key 'evaluator_version': expected {expected}, got {record.evaluator_version!r:.60}")


def _check_times(record: Record) -> None:
    """Refuse times that have not come yet, and a record that is older than its results."""
    created, run = record.created, max(result.created for result in record.results)
    check_time("results.created", run)
    if datetime.fromisoformat(created) > datetime.now(UTC) + CLOCKS_DIFFER:
        raise ResultError(f"key 'created': expected a time that has come, got {created}")
    if datetime.fromisoformat(run) > datetime.fromisoformat(created) + CLOCKS_DIFFER:
        raise ResultError(f"key 'created': expected a time after that of its results, {run}, got {created}")


def _read_curves(data: bytes) -> Curves:
    document = decode(data, Curves, "curves")
    if document.format != CURVES:
        raise ResultError(f"expected curves of the format {CURVES!r}, got {document.format!r:.60}")
    for sequence, curve in document.sequences.items():
        _check_curve(curve, f"curve of {sequence}")
    return document


def _check_curve(curve: Curve, where: str) -> None:
    if len({len(curve.t_s), len(curve.truth), len(curve.path), len(curve.error_m)}) > 1:
        raise ResultError(f"{where}: expected lists of one length")
    for t_s, truth, place, error_m in zip(curve.t_s, curve.truth, curve.path, curve.error_m, strict=True):
        off_m = None if place is None else math.dist(place, truth)
        same = off_m is error_m if off_m is None or error_m is None else abs(off_m - error_m) <= ROUNDED_M
        if not same:
            expected = f"expected the error {off_m}, the distance from the truth, got {error_m}"
            raise ResultError(f"{where}: at {t_s} s: {expected}")
