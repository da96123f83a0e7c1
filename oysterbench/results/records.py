"""ResultRecord, the immutable JSON record that tables, reports and the leaderboard read; statistics over sequences."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import msgspec

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import ResultError
from oysterbench.core.hardware import hardware
from oysterbench.core.locks import locked_if_possible
from oysterbench.core.text import as_unicode, read_json
from oysterbench.evaluate.metrics import FAILED, SPEEDS, TRACKS, find_metric
from oysterbench.evaluate.statistics import summarise
from oysterbench.results.lost import kept_median, lost_sequences
from oysterbench.version import VERSION

FORMAT = "oysterbench-result/2"


def now() -> str:
    """Current time, UTC in ISO 8601, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True, kw_only=True)
class ResultRecord:
    """One run of a method on one sequence, scored.

    track, split, sequence:  what the method was run on; split_digest identifies the exact recipe that it was made from
    hidden:                  whether the split is a hidden one, of whose numbers a board publishes few; None where this
                             is unknown: results of no split, or of versions that did not say
    truth_digest:            SHA-256 of the ground truth that it was scored against, if known
    conditions:              conditions of the sequence (`evaluate.conditions.CONDITIONS`)
    run, seed:               number of the run, from 0, and the seed given to the method; None if it takes none
    method, method_settings: the method that was run
    metrics:                 by keys that include the unit (`evaluate.metrics`); NaN where there is no value
    reasons:                 the reason for every metric that is NaN
    failure:                 why there is no estimate, or why it cannot be scored; None for a run that was scored.
                             A failed run has no estimate: its score and coverage are 0 and its errors do not exist;
                             a score that can be negative is at most 0.
    settings:                of the evaluator
    notes:                   what a reader of the numbers should know, in sentences
    info:                    what the method wants kept with the result
    """

    track: str
    split: str
    sequence: str
    method: str
    metrics: Mapping[str, int | float] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    failure: str | None = None
    split_digest: str = ""
    hidden: bool | None = None
    truth_digest: str = ""
    conditions: Mapping[str, int | float | str] = field(default_factory=dict)
    run: Annotated[int, msgspec.Meta(ge=0)] = 0
    seed: int | None = None
    method_settings: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    info: Mapping[str, Any] = field(default_factory=dict)
    evaluator_version: str = ""
    oysterbench_version: str = VERSION
    hardware: Mapping[str, Any] = field(default_factory=hardware)
    created: str = field(default_factory=now)

    def __post_init__(self) -> None:
        """Copy the mappings, so that later changes by the caller do not reach the record, and check the metrics."""
        for key in _MAPPINGS:
            object.__setattr__(self, key, dict(getattr(self, key)))
        object.__setattr__(self, "notes", tuple(self.notes))
        if self.failure is not None:
            spent = {key: value for key, value in self.metrics.items() if key not in SPEEDS}
            failed = FAILED.get(self.track, {"coverage": 0.0})
            lowest = {key: min(value, spent.get(key, value)) for key, value in failed.items()}
            object.__setattr__(self, "metrics", {**spent, **lowest})
        for key, value in self.metrics.items():
            if abs(value) > sys.float_info.max:  # JSON allows integers that no float can hold
                got = f"{value!s:.60}"
                raise ResultError(f"metric {key!r} of {self.method} on {self.sequence}: expected a number, got {got}")
            if math.isnan(value) and not self.reasons.get(key):
                raise ResultError(
                    f"metric {key!r} of {self.method} on {self.sequence} is NaN: expected the reason in `reasons`"
                )

    def to_dict(self) -> dict[str, Any]:
        """Convert to plain values for JSON; a metric that is NaN becomes None."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        if self.hidden is None:
            del values["hidden"]  # so that records which never had the key keep their bytes, and so their names
        values["metrics"] = {k: None if math.isnan(v) else plain(v) for k, v in self.metrics.items()}
        return {"format": FORMAT, **{key: plain(value) for key, value in values.items()}}

    def to_json(self) -> str:
        """The record as JSON text."""
        return dump(self.to_dict())

    @classmethod
    def from_dict(cls, values: Any, where: str = "result") -> ResultRecord:
        """Make a record from plain values. Raises ResultError naming `where` and the key."""
        if isinstance(values, Mapping):
            values = {"hidden": None, **values}
            if isinstance(metrics := values.get("metrics"), Mapping):
                values["metrics"] = {key: math.nan if value is None else value for key, value in metrics.items()}
        return checked(values, cls, FORMAT, where, "; evaluate again with this version of oysterbench")


_MAPPINGS = [each.name for each in fields(ResultRecord) if str(each.type).startswith("Mapping")]

Checked = TypeVar("Checked")


@lru_cache
def _keys(kind: Hashable) -> tuple[str, ...]:
    return tuple(each.name for each in fields(kind))  # type: ignore[arg-type]


def checked(values: Any, kind: type[Checked], form: str, where: str, remedy: str = "") -> Checked:
    """Make a dataclass from plain JSON values, which must be of the format `form` and have exactly its keys, each of
    the right type. Raises ResultError naming `where` and the key; remedy: what to do if the format is another."""
    if not isinstance(values, Mapping):
        raise ResultError(f"{where}: expected a record (a JSON object), got {type(values).__name__}")
    if values.get("format") != form:
        raise ResultError(f"{where}: key 'format': expected {form!r}, got {values.get('format')!r:.60}{remedy}")
    known = _keys(cast(Hashable, kind))
    given = {key: value for key, value in values.items() if key != "format"}
    for key in given.keys() - set(known):
        raise ResultError(f"{where}: unknown key {key!r:.60}; known keys: {', '.join(known)}")
    for key in known:
        if key not in given:
            raise ResultError(f"{where}: missing key {key!r}")
    try:
        return msgspec.convert(given, kind)
    except msgspec.ValidationError as error:  # "Expected `str`, got `int` - at `$.key`", for a mapping `$.key[...]`
        message, _, place = str(error).partition(" - at `$.")
        key = place.strip("`").partition("[")[0]
        if "[...]" in place:
            key = next((f"{key}.{name}" for name in given[key] if _is_odd(given, key, name, kind)), key)
        raise ResultError(f"{where}: key {key!r}: {message[:1].lower()}{message[1:]}") from None
    except ResultError as error:
        raise ResultError(f"{where}: {error}") from None


def _is_odd(given: Mapping[str, Any], key: str, name: str, kind: type[Any]) -> bool:
    """Whether this item of a mapping is the one of the wrong type."""
    try:
        msgspec.convert({**given, key: {name: given[key][name]}}, kind)
    except msgspec.ValidationError:
        return True
    except ResultError:
        pass
    return False


def plain(value: Any) -> Any:
    """Convert a value to types that JSON has: numpy scalars and arrays, tuples and paths are converted, NaN and
    infinity become None, and what is not Unicode becomes question marks."""
    if isinstance(value, Mapping):
        return {as_unicode(str(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, str):
        return as_unicode(value)
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return as_unicode(str(value))


def dump(value: Any) -> str:
    """Write JSON text that every parser accepts: without bare NaN."""
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)


def _load(text: str, where: str) -> Any:
    try:
        return read_json(text)
    except json.JSONDecodeError as error:
        raise ResultError(f"{where}:{error.lineno}: not valid JSON: {error.msg}") from None
    except ValueError as error:
        raise ResultError(f"{where}: not valid JSON: {error}") from None


def comparable_key(record: ResultRecord) -> tuple[str, ...]:
    """Key that is equal for records whose numbers may be compared: same recipe, same evaluator, same settings."""
    settings = json.dumps(plain(record.settings), sort_keys=True)
    return (record.track, record.split, record.split_digest, record.evaluator_version, settings)


def method_key(record: ResultRecord) -> tuple[str, str]:
    """Key that is equal for runs of one method with the same settings."""
    return record.method, json.dumps(plain(record.method_settings), sort_keys=True)


def samples(records: Sequence[ResultRecord], key: str) -> dict[str, list[float]]:
    """Values of a metric by sequence, one per run; NaN where a run has none."""
    values: dict[str, list[float]] = {}
    for record in records:
        values.setdefault(record.sequence, []).append(float(record.metrics.get(key, math.nan)))
    return values


def mean_weights(records: Sequence[ResultRecord], key: str) -> dict[str, list[float]] | None:
    """Weights of a metric's values in a mean over sequences, shaped like `samples`; None if all count equally.

    Raises ResultError where a record has a value but not its weight.
    """
    metric = find_metric(key)
    if metric is None or not metric.weight:
        return None
    values, weights = samples(records, key), samples(records, metric.weight)
    for name, found in values.items():
        for value, weight in zip(found, weights[name], strict=True):
            if not math.isnan(value) and math.isnan(weight):
                raise ResultError(
                    f"a result of {records[0].method} on {name} has {key}, but not {metric.weight}, by which it counts "
                    "in the mean; evaluate again with this version of oysterbench"
                )
    return weights


def lost_of(results: Sequence[ResultRecord]) -> tuple[str, ...] | None:
    """Names of the sequences that a method lost, from its results; None if its track does not define this."""
    track = TRACKS.get(results[0].track) if results else None
    return None if track is None else lost_sequences(samples(results, track.ranking), results[0].track)


def aggregate(records: Iterable[ResultRecord]) -> list[dict[str, Any]]:
    """Aggregate each metric over sequences, with its statistics, for each track, split and method.

    The aggregate is the mean or, for a track's `errors`, the median over the sequences that are not `lost`. Several
    runs on one sequence are averaged first, so that every sequence has one vote. A failed run counts with the score and
    coverage of its record, at most 0, and has no errors; a metric without any value is None, with the reason. Records
    of different recipes, evaluators or settings are never averaged together: each combination has a row of its own.
    """
    groups: dict[tuple[str, ...], list[ResultRecord]] = {}
    for record in records:
        groups.setdefault((*comparable_key(record), *method_key(record)), []).append(record)
    return [_aggregate_group(group) for group in groups.values()]


def _aggregate_group(group: list[ResultRecord]) -> dict[str, Any]:
    first = group[0]
    summaries = {
        key: summarise(samples(group, key), mean_weights(group, key))
        for key in dict.fromkeys(key for record in group for key in record.metrics)
    }
    reasons: dict[str, str] = {}
    for key, summary in summaries.items():
        if summary.reason:
            reasons[key] = "; ".join(dict.fromkeys(r.reasons[key] for r in group if key in r.reasons))
    lost = lost_of(group)
    errors = TRACKS[first.track].errors if lost is not None else ()
    over = {key: summary.mean for key, summary in summaries.items()}
    over |= {key: kept_median(samples(group, key), lost or ()) for key in errors if key in over}
    reasons |= {
        key: "every sequence is lost" for key in errors if math.isnan(over.get(key, 0.0)) and key not in reasons
    }
    failures = [record for record in group if record.failure is not None]
    if len(failures) == len(group):
        reasons["*"] = f"no run of {first.method} on {first.split or 'these sequences'} could be scored"
    return {
        "track": first.track,
        "split": first.split,
        "split_digest": first.split_digest,
        "method": first.method,
        "method_settings": plain(first.method_settings),
        "metrics": {key: plain(value) for key, value in over.items()},
        "counts": {key: summary.sequences for key, summary in summaries.items()},
        "statistics": {key: plain(asdict(summary)) for key, summary in summaries.items()},
        "reasons": reasons,
        "sequences": len({record.sequence for record in group}),
        "runs": len(group),
        "failures": len(failures),
        "lost": plain(lost),
        "evaluator_version": first.evaluator_version,
        "settings": plain(first.settings),
    }


def document(records: Iterable[ResultRecord], data_set: Any = None) -> dict[str, Any]:
    """Document that `oysterbench eval --json` prints: all records and their aggregate. data_set: results over all
    sequences together that cannot be derived from the records, for tracks that have them."""
    records = list(records)
    made = {"results": [record.to_dict() for record in records], "aggregate": aggregate(records)}
    return made if data_set is None else {**made, "data_set": plain(data_set)}


def write_results(path: str | os.PathLike[str], records: Iterable[ResultRecord], data_set: Any = None) -> None:
    """Write `document(records)` as JSON, atomically."""
    write_atomically(path, (as_unicode(dump(document(records, data_set))) + "\n").encode())


def add_results(
    path: str | os.PathLike[str], records: Iterable[ResultRecord], data_set: Sequence[Any] | None = None
) -> list[ResultRecord]:
    """Write results into a file, where they replace those of the same method on the same sequence. Several processes
    may do so at once: none loses what another has added.

    Returns the other records, which stay. Raises ResultError, leaving the file as it is, where it is no results file.
    """
    records, path = list(records), Path(path)
    places, methods = {_place(record) for record in records}, {record.method for record in records}
    with locked_if_possible(path.with_name(f".{path.name}.lock")):  # another command may be adding its own
        before, rows = _read(path) if path.exists() else ([], ())
        kept = [record for record in before if _place(record) not in places]
        kept_rows = [row for row in rows if row["method"] not in methods]
        together = None if data_set is None and not kept_rows else [*kept_rows, *(data_set or ())]
        write_results(path, [*kept, *records], together)
    return kept


def replaced(before: Iterable[ResultRecord], records: Iterable[ResultRecord]) -> list[str]:
    """What results in a file these replace that would not be the same again, in words: results of another ground truth,
    evaluator or settings, and those of more runs."""

    def made_by(record: ResultRecord) -> tuple[str, ...]:
        return record.truth_digest, *comparable_key(record)

    old, new = _by_place(before), _by_place(records)
    found = []
    for place in old.keys() & new.keys():
        was, now = old[place], new[place]
        what = f"{was[0].method} on {was[0].sequence}"
        if {made_by(one) for one in was} - {made_by(one) for one in now}:
            found.append(f"the result of {what}, of another ground truth, evaluator or settings")
        elif len(was) > len(now):
            found.append(f"the results of {len(was)} runs of {what} by {len(now)}")
    return sorted(found)


def _by_place(records: Iterable[ResultRecord]) -> dict[tuple[str, ...], list[ResultRecord]]:
    places: dict[tuple[str, ...], list[ResultRecord]] = {}
    for record in records:
        places.setdefault(_place(record), []).append(record)
    return places


def _place(record: ResultRecord) -> tuple[str, ...]:
    """Key that is equal for results of which only the latest counts."""
    return record.track, record.split, record.sequence, record.method


def output_place(record: ResultRecord) -> Path:
    """Folder of a run's full output, relative to that of its results."""
    return Path("runs", record.method, record.sequence, f"{record.run + 1}")


def read_results(path: str | os.PathLike[str]) -> list[ResultRecord]:
    """Read the records of a file written by `write_results`. Raises ResultError naming file and key."""
    return _read(Path(path))[0]


def _read(path: Path) -> tuple[list[ResultRecord], Sequence[Mapping[str, Any]]]:
    """Read the records and the rows of `data_set`."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ResultError(f"{path}: no such file; `oysterbench eval` writes results") from None
    except UnicodeDecodeError:
        raise ResultError(f"{path} is not text; expected results in JSON") from None
    except OSError as error:
        raise ResultError(f"{path}: cannot be read: {error.strerror or error}") from None
    content = _load(text, str(path))
    if not isinstance(content, Mapping) or not isinstance(content.get("results"), list):
        raise ResultError(f"{path}: expected an object with the list 'results', as `oysterbench eval` writes it")
    records = [ResultRecord.from_dict(values, f"{path}: results[{i}]") for i, values in enumerate(content["results"])]
    rows = content.get("data_set") or []
    if not isinstance(rows, list) or not all(isinstance(row, Mapping) and "method" in row for row in rows):
        raise ResultError(f"{path}: key 'data_set': expected a list of rows with a method each")
    return records, rows
