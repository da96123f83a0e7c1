"""Metrics reached with trained weights, from results made with them, for the model card of their release."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import TRACKS, find_metric
from oysterbench.hub.model import Figure
from oysterbench.results.records import ResultRecord, aggregate, read_results


def card_figures(path: Path, name: str, sha256: str) -> list[Figure]:
    """Read the metrics that methods reached with given weights, those of a track's tables, from a results file or a
    folder that holds one.

    name, sha256: of the weights. Results of methods that do not use them are skipped. Raises ResultError where there
    are no results with these weights, or a run with them failed.
    """
    path = path / "results.json" if path.is_dir() else path
    records = read_results(path)
    known = [(record, weights_in(record).get(name)) for record in records]
    own = [record for record, digest in known if digest == sha256]
    if not own:
        others = sorted({f"{record.method} with {digest[:12]}…" for record, digest in known if digest})
        raise ResultError(
            f"{path}: expected results of these weights of {name} (SHA-256 {sha256[:12]}…), got "
            f"{', '.join(others) or 'none that says which weights it was made with'}; create some with `oysterbench "
            "run`"
        )
    if failed := [record for record in own if record.failure is not None]:
        raise ResultError(
            f"{path}: {failed[0].method} failed on {failed[0].sequence}: {failed[0].failure}; `oysterbench run "
            "--retry` repeats it"
        )
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return [figure for row in aggregate(own) for figure in _figures(row, digest)]


def weights_in(record: ResultRecord) -> dict[str, str]:
    """SHA-256 of the trained weights that a result was made with, by name."""
    found = record.method_settings.get("weights")
    return {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else {}


def _figures(row: dict[str, Any], results: str) -> list[Figure]:
    """Figures of one row of `aggregate`; results: SHA-256 of the results file."""
    found = []
    for key in TRACKS[row["track"]].table:
        value, metric = row["metrics"].get(key), find_metric(key, row["track"])
        if value is None or metric is None:
            continue
        # An error is a median over the sequences that are not lost, the interval that of the mean over all.
        median = key in TRACKS[row["track"]].errors
        interval: dict[str, float | None] = {} if median else row["statistics"][key]["interval"]
        found.append(
            Figure(
                method=row["method"],
                track=row["track"],
                split=row["split"],
                split_digest=row["split_digest"],
                sequences=row["sequences"],
                metric=key,
                heading=metric.heading,
                unit=metric.unit,
                better=metric.better,
                value=float(value),
                evaluator=row["evaluator_version"],
                results=results,
                low=interval.get("low"),
                high=interval.get("high"),
            )
        )
    return found
