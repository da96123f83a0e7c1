"""Reported results, computed by others: checks of a results.json of a public split before it may go on the board."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.text import web_host
from oysterbench.evaluate.metrics import find_metric
from oysterbench.results.machines import machine_of
from oysterbench.results.plausible import BOUNDING, check_plausible
from oysterbench.results.records import ResultRecord, aggregate, method_key
from oysterbench_leaderboard.storage.record import check_text
from oysterbench_leaderboard.submissions.catalogue import Wanted, why
from oysterbench_leaderboard.submissions.reading.archive import Limits, shown
from oysterbench_leaderboard.submissions.reading.predictions import refusing
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.scoring import evaluator

LONGEST = 2000
"""Maximum length of a text or key in results, characters."""

MOST_MACHINE = 200
"""Maximum length of the description of processor and cores, characters."""

EARLIEST, TOLERANCE = datetime(2020, 1, 1, tzinfo=UTC), timedelta(days=1)
"""Earliest plausible date of results (before the benchmark existed), and tolerance for clocks that differ."""


def read_reported(data: bytes, content: dict[str, Any], wanted: Wanted, limits: Limits) -> tuple[ResultRecord, ...]:
    """Read reported results. They must be of this split and this version's evaluator, with known metrics only, the
    metrics that bound others, and plausible values. Raises Refusal.

    data, content: the bytes of the results.json, and what they were parsed into
    """
    if wanted.hidden:
        raise Refusal("type", f"{wanted.split} is hidden: results are computed here; expected estimates")
    if len(data) > limits.results_bytes:
        raise Refusal("size", f"results.json: expected at most {limits.results_bytes // 1_000_000} MB, got {len(data)}")
    rows = content["results"]
    if not isinstance(rows, list) or not rows:
        raise Refusal("format", "results.json: key 'results': expected a list of results, as `oysterbench eval` writes")
    found = []
    with refusing("results.json"):
        found = [ResultRecord.from_dict(row, f"results.json: results[{i}]") for i, row in enumerate(rows)]
    for i, record in enumerate(found):
        where = f"results.json: results[{i}]"
        expected = (("track", wanted.track), ("split", wanted.split), ("split_digest", wanted.split_digest))
        for key, value in expected:
            got = getattr(record, key)
            if got != value:
                more = why(got) if key == "track" else ""
                raise Refusal("format", f"{where}: key {key!r}: expected {value}, got {got!r:.80}{more}")
        if record.sequence not in wanted.sequences:
            raise Refusal("format", f"{where}: {shown(record.sequence)} is no sequence of {wanted.split}")
        for key in record.metrics:
            if find_metric(key) is None:
                raise Refusal("format", f"{where}: {shown(key)} is no metric that this version of oysterbench knows")
        _check_evaluator(record, where)
    if len({method_key(record) for record in found}) > 1:
        raise Refusal("format", "results.json: expected results of one method with one setting, got several")
    if len({(record.sequence, record.run) for record in found}) < len(found):
        raise Refusal("format", "results.json: expected each run of a sequence once, got one of them twice")
    truths = {(record.sequence, record.truth_digest) for record in found if record.truth_digest}
    if len({sequence for sequence, _ in truths}) < len(truths):
        raise Refusal("format", "results.json: expected one ground truth of a sequence, got several")
    with refusing("results.json"):
        for i, record in enumerate(found):
            where = f"results.json: results[{i}]"
            lacking = [key for key in BOUNDING.get(record.track, ()) if key not in record.metrics]
            if lacking and record.failure is None:
                raise Refusal("format", f"{where}: expected the metrics {', '.join(lacking)}, which are not there")
            check_plausible(record, where)
            _check_created(record.created, where)
            _check_code(record.info.get("method"), where)
            if (size := len(machine_of(record.hardware))) > MOST_MACHINE:
                at_most = f"expected at most {MOST_MACHINE} characters of processor and cores, got {size}"
                raise Refusal("text", f"{where}: key 'hardware': {at_most}")
        aggregate(found)
        _check_texts([record.to_dict() for record in found], "results.json")
    return tuple(found)


def _check_evaluator(record: ResultRecord, where: str) -> None:
    """Refuse results of another evaluator, or with another setting than the usual ones, naming it. Raises Refusal."""
    version, usual = evaluator(record.track)
    if record.evaluator_version != version:
        got = f"expected the evaluator {version!r}, got {record.evaluator_version!r:.40}"
        raise Refusal("format", f"{where}: {got}; evaluate again with this version of oysterbench")
    given = record.settings
    for key in sorted(usual.keys() | given.keys()):
        if (key in given, given.get(key)) == (key in usual, usual.get(key)):
            continue
        expected, got = (f"{one[key]!r:.60}" if key in one else "nothing" for one in (usual, given))
        raise Refusal(
            "format",
            f"{where}: expected the evaluator {version!r} with its usual settings, got others: key "
            f"{f'settings.{key:.60}'!r}: expected {expected}, got {got}; evaluate again with the usual ones",
        )


def _check_created(created: str, where: str) -> None:
    """Refuse a `created` that is not a plausible UTC time. Raises Refusal."""
    try:
        at = datetime.strptime(created, "%Y-%m-%dT%H:%M:%S%z")
    except ValueError:
        at = None
    if at is None or not EARLIEST <= at <= datetime.now(UTC) + TOLERANCE:
        expected = f"a time from {EARLIEST:%Y} to now, as 2026-11-01T12:00:00Z"
        raise Refusal("format", f"{where}: key 'created': expected {expected}, got {created!r:.40}")


def _check_code(said: Any, where: str) -> None:
    """Refuse an address of a method's code that cannot be opened. Raises Refusal."""
    code = said.get("code") if isinstance(said, dict) else None
    if isinstance(code, str) and code.startswith(("http://", "https://")) and not web_host(code):
        expected = "a web address, or a name or path without http://"
        raise Refusal("format", f"{where}: key 'info.method.code': expected {expected}, got {code!r:.80}")


def _check_texts(value: Any, where: str) -> None:
    """Refuse texts in results that no page could show. Raises Refusal."""
    if isinstance(value, str):
        try:
            check_text("text", value, LONGEST)
            value.encode()
        except (OysterbenchError, UnicodeEncodeError) as error:
            raise Refusal("text", f"{where}: {' '.join(str(error).split())}") from None
    elif isinstance(value, dict):
        for key, item in value.items():
            _check_texts(key, f"{where}: key {shown(key)}")
            _check_texts(item, f"{where}: key {shown(key)}")
    elif isinstance(value, list):
        for item in value:
            _check_texts(item, where)
