"""What the index keeps of a record: its columns in tables, and the summary by which it is ranked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from oysterbench.core.errors import ResultError
from oysterbench.core.text import unseen
from oysterbench.evaluate.metrics import FAILED, TRACKS, find_metric
from oysterbench.evaluate.statistics import Sample, mean_over_sequences, sequence_means, sequence_weights, weighed_means
from oysterbench.hub.canonical import sha256
from oysterbench.report.columns import OF_TRACK, STANDING_OF_TRACK
from oysterbench.results.lost import kept_median
from oysterbench.results.machines import machine_of
from oysterbench.results.plausible import check_range
from oysterbench.results.records import ResultRecord, lost_of, samples
from oysterbench.results.standings import PRIMARY, UNPREDICTED_WEIGHT, SequenceScores
from oysterbench_leaderboard.storage.record import Record

COLUMNS: dict[str, tuple[str, ...]] = {
    track: tuple(dict.fromkeys(c.key for c in (*STANDING_OF_TRACK[track], *OF_TRACK[track]) if c.key != metric))
    for track, metric in PRIMARY.items()
}
"""Track -> metrics shown beside the ranking one."""

SENSORS = {"mono", "stereo", "imu", "dvl", "sonar", "pressure", "compass", "altimeter"}
"""Words that a method may use for the sensors that it reads."""

MOST_SAID = {"code": 300, "paper": 500}
"""Other statement of a method -> maximum number of characters."""

MOST_MACHINE = 120
"""Maximum number of characters shown of a machine's description."""


class RecordSummary(msgspec.Struct, frozen=True):
    """Summary by which a record is ranked; the database stores it as JSON.

    scores:    on each sequence; NaN, null in JSON, where there is no value although the sequence was run
    coverage:  of the sequences that have one
    sequences: of the record, in its order; failed: number of failed runs
    hidden:    whether its split is hidden, as its results say; None where they do not
    """

    scores: SequenceScores
    coverage: dict[str, float]
    sequences: tuple[str, ...]
    failed: int
    hidden: bool | None = None

    @classmethod
    def decode(cls, data: str) -> RecordSummary:
        """Decode what `msgspec.json.encode` wrote."""
        values = msgspec.json.decode(data)
        scores = values["scores"]["values"]
        values["scores"]["values"] = {name: math.nan if value is None else value for name, value in scores.items()}
        return msgspec.convert(values, cls)


def read_record(data: bytes, digest: str) -> Record:
    """Read a record from the bytes of its file. Raises ResultError, without its name, where they do not match `digest`
    or are no record of a known track."""
    if sha256(data) != digest:
        raise ResultError("its bytes do not match its name: it was changed")
    try:
        record = Record.from_dict(msgspec.json.decode(data), "record")
    except (msgspec.DecodeError, RecursionError) as error:
        raise ResultError(f"expected JSON: {error}") from None
    if record.track not in PRIMARY:
        raise ResultError(f"track {record.track!r:.60}: expected one of {', '.join(PRIMARY)}")
    return record


def summarise_record(record: Record) -> RecordSummary:
    """Summarise a record for ranking. Raises ResultError where a value lacks its weight in the mean, or a weight is
    negative."""
    metric = PRIMARY[record.track]
    values, (sample, weights) = samples(record.results, metric), _weighed_sample(record.results, metric)
    unpredicted = UNPREDICTED_WEIGHT.get(_weight(metric))
    # Predicted but without a value, such as AP where there is nothing to find: not a failure, and not in any mean.
    without = {name: math.nan for name, of in values.items() if all(map(math.isnan, of))}
    return RecordSummary(
        SequenceScores(
            {**weighed_means(sample, weights), **without},
            None if weights is None else sequence_weights(sample, weights),
            sequence_means(_weights(record.results, unpredicted)) if unpredicted else None,
        ),
        sequence_means(samples(record.results, "coverage")) if "coverage" in FAILED[record.track] else {},
        tuple(dict.fromkeys(result.sequence for result in record.results)),
        sum(result.failure is not None for result in record.results),
        record.results[0].hidden,
    )


def check_shown(record: Record, means: Mapping[str, Any], whole: float | None) -> None:
    """Refuse a record that a board would rank or show by something impossible: results of another method, or a
    value outside its range. Only `verify` looks at its other numbers, which takes longer than reading it. Raises
    ResultError.

    means: `column_means`; whole: `data_set_value`
    """
    for result in record.results:
        if result.method != record.method:
            raise ResultError(f"expected results of {record.method}, got some of {result.method!r:.80}")
    for key in (PRIMARY[record.track], "coverage"):
        metric = find_metric(key, record.track)
        low, high = (-math.inf, math.inf) if metric is None else metric.range
        for result in record.results:
            value = result.metrics.get(key, math.nan)
            if value < low or value > high:  # not NaN, which is no value
                check_range(key, value, record.track, f"run {result.run + 1} on {result.sequence}")
    for key, value in ((PRIMARY[record.track], whole), *means.items()):
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ResultError(f"{key} over all sequences: expected a number or null, got {value!r:.60}")
        check_range(key, value, record.track, "over all sequences")


def column_means(record: Record) -> dict[str, float | None]:
    """`means_over_sequences` of `COLUMNS`; None where there is no value. Records on hidden splits have only these
    means."""
    known: Any = (record.data_set or {}).get("means")
    if isinstance(known, dict):
        return {key: known.get(key) for key in COLUMNS[record.track]}
    return means_over_sequences(record.results, COLUMNS[record.track])


def means_over_sequences(results: Sequence[ResultRecord], keys: Iterable[str]) -> dict[str, float | None]:
    """Means of metrics over the sequences that have them, weighted where the metric is; for errors, medians over the
    sequences that are not lost. None where there is no value."""
    errors, lost = TRACKS[results[0].track].errors, lost_of(results) or ()
    means = {
        key: kept_median(samples(results, key), lost)
        if key in errors
        else mean_over_sequences(*_weighed_sample(results, key))
        for key in keys
    }
    return {key: None if math.isnan(mean) else mean for key, mean in means.items()}


def data_set_value(record: Record) -> float | None:
    """Ranking metric over all sequences at once; None where the record does not have it."""
    metrics: Any = (record.data_set or {}).get("metrics")
    value = metrics.get(PRIMARY[record.track]) if isinstance(metrics, dict) else None
    return float(value) if isinstance(value, int | float) else None


def _weighed_sample(results: Sequence[ResultRecord], key: str) -> tuple[Sample, Sample | None]:
    """Values of a metric by sequence, and their weights; None for a metric without weights. A sequence with a failed
    run that has no weight is left out: its weight without predictions is known only to the board. Raises ResultError
    where a run that did not fail lacks its weight, or a weight is negative."""
    values, weight = samples(results, key), _weight(key)
    if not weight:
        return values, None
    weights = _weights(results, weight)
    for result in results:
        lacks = math.isnan(result.metrics.get(weight, math.nan)) and not math.isnan(result.metrics.get(key, math.nan))
        if lacks and result.failure is None:
            raise ResultError(f"a result on {result.sequence} has {key}, but not {weight}, its weight in the mean")
    values = {name: found for name, found in values.items() if not any(map(math.isnan, weights[name]))}
    return values, {name: weights[name] for name in values}


def _weights(results: Sequence[ResultRecord], key: str) -> Sample:
    """`samples` of a metric that gives weights. Raises ResultError where one is negative."""
    found = samples(results, key)
    for name, values in found.items():
        for value in values:
            if value < 0:
                raise ResultError(f"a result on {name} has {key} = {value:g}: expected 0 or more, as it is a weight")
    return found


def _weight(key: str) -> str:
    """Key of the metric that gives the weights of another; empty where each sequence has one vote."""
    found = find_metric(key)
    return "" if found is None else found.weight


def said_of_method(record: Record) -> dict[str, str]:
    """What a method states about itself, as columns of `board.Row`: sensors, and "online" or "offline", in fixed words
    only; where its code is, and its paper, as plain text. Each empty where its results do not state it. Also the
    machine that it ran on; empty where there were several."""
    said = record.results[0].info.get("method")
    said = said if isinstance(said, dict) else {}
    machines = {machine_of(result.hardware) for result in record.results}
    sensors, online = said.get("sensors"), said.get("online")
    known = isinstance(sensors, list) and bool(sensors) and set(map(str, sensors)) <= SENSORS
    return {
        "sensors": ", ".join(sensors) if known and sensors else "",
        "mode": {True: "online", False: "offline"}.get(online, "") if isinstance(online, bool) else "",
        **{key: _plain(said.get(key), most) for key, most in MOST_SAID.items()},
        "machine": _plain(_shortened(machines.pop()) if len(machines) == 1 else "", MOST_MACHINE),
    }


def _shortened(machine: str) -> str:
    """Shorten a long description of a machine to its start and its end, which has the number of cores."""
    if len(machine) <= MOST_MACHINE:
        return machine
    return f"{machine[: MOST_MACHINE - 40]}\N{HORIZONTAL ELLIPSIS}{machine[-39:]}"


def _plain(text: Any, most: int) -> str:
    return text if isinstance(text, str) and len(text) <= most and unseen(text) is None else ""
