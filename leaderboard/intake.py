"""What an index keeps of a record: read from its bytes fast, as there may be hundreds of thousands of them.

`Record.from_dict` checks every value, which is right for a record that comes in and too slow for all that are there.
Here the hash vouches for the bytes, and what is checked is what is used: `oysterbench leaderboard verify` checks all.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import orjson

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import FAILED, find_metric
from oysterbench.hub.canonical import canonical, sha256
from oysterbench.report.columns import OF_TRACK, STANDING_OF_TRACK
from oysterbench.results.comparison import PRIMARY
from oysterbench.results.records import FORMAT as RESULT_FORMAT
from oysterbench.results.records import ResultRecord
from oysterbench_leaderboard.ranking import MISSED, Answers
from oysterbench_leaderboard.record import FORMAT, TIERS, Record

MOST_COLUMNS = 12

COLUMNS: dict[str, tuple[str, ...]] = {
    track: tuple(dict.fromkeys(c.key for c in (*STANDING_OF_TRACK[track], *OF_TRACK[track]) if c.key != metric))
    for track, metric in PRIMARY.items()
}
"""Track -> metrics that stand beside the one that ranks."""

assert all(len(columns) <= MOST_COLUMNS for columns in COLUMNS.values())

_KEYS = {"format", *(f.name for f in fields(Record))}
_RESULT_KEYS = {"format", *(f.name for f in fields(ResultRecord))}
_NUMBERS = {float, int, type(None)}
_TEXTS = ("method", "team", "tier", "url", "summary", "created", "supersedes")


@dataclass(frozen=True, slots=True)
class Kept:
    """Of a record: what tables show, and what its board is ranked by.

    board:    its id; about: track, split, recipe, evaluator and its settings, which the id is the hash of
    answers:  what ranks it
    data_set: the ranking metric over all sequences at once, where the record knows it
    coverage: of the sequences that have one
    columns:  means of `COLUMNS` over its own sequences, without coverage; None where there is none
    failed:   runs that failed
    """

    digest: str
    board: str
    about: tuple[str, str, str, str, str]
    method: str
    team: str
    tier: str
    url: str
    summary: str
    created: str
    supersedes: str
    answers: Answers
    data_set: float | None
    coverage: Mapping[str, float]
    columns: tuple[float | None, ...]
    sequences: tuple[str, ...]
    runs: int
    failed: int


def keep(data: bytes, digest: str) -> Kept:
    """What to keep of a record's bytes. Raises ResultError, without its name, where they are not those of a record."""
    if sha256(data) != digest:
        raise ResultError("its bytes are not those it is named for; it was changed")
    try:
        values = orjson.loads(data)
    except orjson.JSONDecodeError as error:
        raise ResultError(f"expected JSON: {error}") from None
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise ResultError(f"expected the format {FORMAT!r}")
    if odd := values.keys() ^ _KEYS:
        raise ResultError(f"keys that are missing or unknown: {', '.join(sorted(odd)):.200}")
    for key in _TEXTS:
        if not isinstance(values[key], str):
            raise ResultError(f"key {key!r}: expected text")
    if values["tier"] not in TIERS:
        raise ResultError(f"key 'tier': expected one of {', '.join(TIERS)}, got {values['tier']!r:.60}")
    results = values["results"]
    if not isinstance(results, list) or not results:
        raise ResultError("key 'results': expected results, got none")
    for result in results:
        _check(result, results[0])
    first = results[0]
    about = (
        first["track"],
        first["split"],
        first["split_digest"],
        first["evaluator_version"],
        _settings(orjson.dumps(first["settings"], option=orjson.OPT_SORT_KEYS)),
    )
    runs = by_sequence(results)
    metric, columns = PRIMARY[about[0]], COLUMNS[about[0]]
    means, weights = run_means(runs, metric)
    missed = run_means(runs, MISSED[_weight(metric)])[0] if _weight(metric) in MISSED else None
    # Answered, and yet without a value, as AP is where nothing is to be found: no failure, and in no mean.
    without = dict.fromkeys((name for name in runs if name not in means), math.nan)
    if weights is not None:  # a failed run without a weight answers nothing: the board knows what that weighs
        means = {name: value for name, value in means.items() if name in weights}
    return Kept(
        digest=digest,
        board=board_id(about),
        about=about,
        **{key: values[key] for key in _TEXTS},
        answers=Answers(digest, means | without, weights, missed),
        data_set=_data_set(values["data_set"], metric),
        coverage=run_means(runs, "coverage")[0] if "coverage" in FAILED[about[0]] else {},
        columns=tuple(None if key == "coverage" else column_mean(runs, key) for key in columns),
        sequences=tuple(runs),
        runs=len(results),
        failed=sum(result["failure"] is not None for result in results),
    )


def _check(result: Any, first: Any) -> None:
    if not isinstance(result, dict) or result.keys() != _RESULT_KEYS or result["format"] != RESULT_FORMAT:
        raise ResultError(f"key 'results': expected results of the format {RESULT_FORMAT!r}")
    for key in ("track", "split", "split_digest", "evaluator_version", "sequence"):
        if not isinstance(result[key], str):
            raise ResultError(f"key 'results': key {key!r}: expected text")
        if key != "sequence" and result[key] != first[key]:
            raise ResultError("expected results of one split, evaluator and setting, got several")
    if result["track"] not in PRIMARY:
        raise ResultError(f"track {result['track']!r:.60}: expected one of {', '.join(PRIMARY)}")
    if result["settings"] != first["settings"]:
        raise ResultError("expected results of one split, evaluator and setting, got several")
    if not isinstance(result["settings"], dict) or not isinstance(result["metrics"], dict):
        raise ResultError("key 'results': expected objects as settings and metrics")
    if not _NUMBERS.issuperset(map(type, result["metrics"].values())):
        raise ResultError("key 'results': key 'metrics': expected numbers or null")


def _data_set(found: Any, metric: str) -> float | None:
    """Of a record's `data_set`, the ranking metric."""
    metrics = found.get("metrics") if isinstance(found, dict) else None
    value = metrics.get(metric) if isinstance(metrics, dict) else None
    return float(value) if isinstance(value, int | float) else None


@lru_cache(maxsize=256)
def _settings(text: bytes) -> str:
    """As `results.comparable_key` spells them."""
    return json.dumps(orjson.loads(text), sort_keys=True)


@lru_cache(maxsize=256)
def board_id(about: tuple[str, str, str, str, str]) -> str:
    """As `Record.board`."""
    return sha256(canonical(list(about)))[:16]


def by_sequence(results: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Sequence -> its runs' results, in the order of their first appearance."""
    runs: dict[str, list[Mapping[str, Any]]] = {}
    for result in results:
        runs.setdefault(result["sequence"], []).append(result)
    return runs


def run_means(
    runs: Mapping[str, Sequence[Mapping[str, Any]]], key: str
) -> tuple[dict[str, float], dict[str, float] | None]:
    """Sequence -> mean of a metric over the runs that have it; and its weight, where it has one: as
    `evaluate.statistics` takes them. Raises ResultError where a run has a value, did not fail, and has no weight."""
    weight = _weight(key)
    means: dict[str, float] = {}
    weights: dict[str, float] = {}
    for name, results in runs.items():
        if len(results) == 1 and not weight:  # as most are
            if (value := results[0]["metrics"].get(key)) is not None:
                means[name] = float(value)
            continue
        values = [result["metrics"].get(key) for result in results]
        known = [float(value) for value in values if value is not None]
        if not known:
            continue
        means[name] = known[0] if len(known) == 1 else math.fsum(known) / len(known)
        if not weight:
            continue
        shares = [result["metrics"].get(weight) for result in results]
        lacking = [
            r for r, value, share in zip(results, values, shares, strict=True) if share is None and value is not None
        ]
        if any(result["failure"] is None for result in lacking):
            raise ResultError(f"a result on {name} has {key}, but not {weight}, by which it counts in the mean")
        if lacking or None in shares:
            continue
        weights[name] = math.fsum(shares) / len(shares)
        pairs = [(value, share) for value, share in zip(values, shares, strict=True) if value is not None]
        if (total := math.fsum(share for _, share in pairs)) > 0 and len(pairs) > 1:
            means[name] = math.fsum(value * share for value, share in pairs) / total
    return means, weights if weight else None


def column_mean(runs: Mapping[str, Sequence[Mapping[str, Any]]], key: str) -> float | None:
    """Mean over sequences, weighed where the metric is; None where there is none."""
    means, weights = run_means(runs, key)
    if weights is not None:
        means = {name: value for name, value in means.items() if name in weights}
    if not means:
        return None
    if weights is None or not any(weights.values()):
        return math.fsum(means.values()) / len(means)
    return math.fsum(means[name] * weights[name] for name in means) / math.fsum(weights[name] for name in means)


@lru_cache(maxsize=256)
def _weight(key: str) -> str:
    """Key of the metric that weighs another; empty where each sequence has one vote."""
    found = find_metric(key)
    return "" if found is None else found.weight
