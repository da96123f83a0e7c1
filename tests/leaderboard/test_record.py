"""Records: what they may be, and that their bytes are theirs alone."""

from __future__ import annotations

import json
from dataclasses import replace

import msgspec
import pytest

from oysterbench.core.errors import ResultError
from oysterbench.hub.canonical import canonical, sha256
from oysterbench_leaderboard.storage.record import MOST_TEXT, Record
from oysterbench_leaderboard.storage.record_summary import RecordSummary, read_record, summarise_record
from tests.helpers.records_made import record_made


def test_a_record_is_the_same_after_writing_and_reading():
    record = record_made(runs=2, failed=("val-03",), url="https://example.org", summary="Étude.")
    again = Record.from_dict(json.loads(record.data))
    assert again == record
    assert (again.data, again.digest) == (record.data, sha256(record.data))


def test_its_board_is_that_of_split_evaluator_and_settings():
    record = record_made()
    assert record_made("other", skill=0.1).board == record.board
    assert record_made(evaluator="slam 2").board != record.board
    changed = replace(record.results[0], settings={**record.results[0].settings, "align": "se3"})
    assert replace(record, results=(changed,)).board != record.board


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("method", "a\u202eb", "plain text"),
        ("method", "a\nb", "plain text"),
        ("method", "\ufeff", "plain text"),
        ("team", " ", "an empty one"),
        ("summary", "x" * (MOST_TEXT["summary"] + 1), "at most 500"),
        ("url", "javascript:alert(1)", "expected https://"),
        ("url", "http://", "with the name of a host"),
        ("url", "https://a b", "with the name of a host"),
        ("url", "https://a:port/", "with the name of a host"),
        ("tier", "best", "expected one of baseline"),
        ("supersedes", "../../etc/passwd", "SHA-256"),
        ("curves", "A" * 64, "SHA-256"),
        ("results", (), "expected results"),
    ],
)
def test_what_is_no_record_is_refused_by_key(key, value, message):
    with pytest.raises(ResultError, match=message):
        replace(record_made(), **{key: value})


def test_results_of_one_board_and_each_run_once():
    record, other = record_made(), record_made(evaluator="slam 1")
    with pytest.raises(ResultError, match="got several"):
        replace(record, results=(record.results[0], other.results[1]))
    with pytest.raises(ResultError, match="one of them twice"):
        replace(record, results=(record.results[0], record.results[0]))


@pytest.mark.parametrize(
    "change", [{"extra": 1}, {"format": "oysterbench-record/9"}, {"results": {}}, {"estimates": []}]
)
def test_another_format_or_key_is_refused(change):
    with pytest.raises(ResultError):
        Record.from_dict({**record_made().to_dict(), **change})


def test_the_index_keeps_what_the_record_holds():
    record = record_made(runs=3, failed=("val-02",), without=("val-05",))
    summary = summarise_record(read_record(record.data, record.digest))
    assert (summary.failed, len(summary.sequences)) == (3, 7)
    assert RecordSummary.decode(msgspec.json.encode(summary).decode()) == summary
    with pytest.raises(ResultError, match="it was changed"):
        read_record(record.data + b" ", record.digest)
    odd = canonical({**record.to_dict(), "extra": 1})
    with pytest.raises(ResultError, match="extra"):
        read_record(odd, sha256(odd))
