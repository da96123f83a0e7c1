"""Files named by their hash: kept once, never believed when changed."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.curves import curves_document
from oysterbench_leaderboard.store import RecordStore, StatusChange
from oysterbench_leaderboard.verifying import verify
from tests.helpers.records_made import fill, record_made


def test_records_are_kept_once_and_listed_in_order(tmp_path):
    store = RecordStore(tmp_path)
    record = record_made()
    digest = store.add(record)
    assert store.add(record) == digest == record.digest
    other = store.add(record_made("other"))
    assert store.digests() == sorted([digest, other])
    assert store.record(digest) == record
    (tmp_path / "records" / f".{digest}.json.abc").write_text("left by a writer that was killed")
    assert store.digests() == sorted([digest, other])
    assert verify(store).problems == {}


def test_a_changed_or_absent_file_is_refused(tmp_path):
    store = RecordStore(tmp_path)
    digest = store.add(record_made())
    path = tmp_path / "records" / f"{digest}.json"
    path.write_bytes(path.read_bytes().replace(b"carp", b"cord"))
    with pytest.raises(ResultError, match="it was changed"):
        store.record(digest)
    with pytest.raises(ResultError, match="no such record"):
        store.record("0" * 64)
    with pytest.raises(ResultError, match="SHA-256"):
        store.record("../records/x")


def test_notices_come_in_the_order_in_which_they_were_made(tmp_path):
    store = RecordStore(tmp_path)
    later, earlier = (StatusChange("a" * 64, "restored", "b", f"2026-0{k}-01T00:00:00Z") for k in (5, 4))
    store.add_status_change(later)
    store.add_status_change(earlier)
    assert store.status_changes() == [earlier, later]
    (tmp_path / "changes" / f"{'1' * 64}.json").write_text("{}")
    assert len(store.read_status_changes()[0]) == 2
    with pytest.raises(ResultError):
        store.status_changes()


def test_verify_reads_every_file_whole(tmp_path):
    store = RecordStore(tmp_path)
    fill(store)
    before = verify(store)
    assert before.problems == {}
    curve = {"run": 0, "t_s": [0.0], "truth": [[0, 0, 0]], "path": [None], "error_m": [None]}
    kept = store.add_curves(curves_document({"val-01": curve}, "posyaw"))
    odd = store.add_curves(curves_document({"val-01": {**curve, "path": []}}, "posyaw"))
    lost = store.add(record_made(curves="b" * 64))
    store.add(record_made("drawn", curves=kept))
    found = verify(store)
    assert found.checked == {"records": len(store.digests()), "changes": 1, "curves": before.checked["curves"] + 2}
    assert set(found.problems) == {f"curves/{odd}.json", f"records/{lost}.json"}
