"""Files named by their hash: kept once, never believed when changed."""

from __future__ import annotations

from typing import Any

import pytest

from oysterbench.core.errors import ResultError
from oysterbench.hub.canonical import canonical, sha256
from oysterbench_leaderboard.boards.memory import MemoryIndex
from oysterbench_leaderboard.publishing.verifying import verify
from oysterbench_leaderboard.storage.curves import FORMAT as CURVES
from oysterbench_leaderboard.storage.curves import curves_document
from oysterbench_leaderboard.storage.store import FORMAT, KINDS, RecordStore, StatusChange
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


def test_a_file_that_was_damaged_is_written_again_where_its_bytes_are_given(tmp_path):
    store = RecordStore(tmp_path)
    digest = store.add(record_made())
    (path,) = (tmp_path / "records").iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    assert store.add(record_made()) == digest
    assert path.read_bytes() == whole


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


@pytest.mark.parametrize("created", ["zzz", "", "2026-02-30T00:00:00Z", "9999-12-31T23:59:59Z", "2026-11-01"])
def test_a_notice_of_no_time_is_refused_and_does_not_keep_from_others(tmp_path, created):
    store = RecordStore(tmp_path)
    digest = store.add(record_made())
    odd = {"format": FORMAT, "record": digest, "action": "restored", "reason": "x", "created": created}
    keep(store, "changes", canonical(odd))
    with pytest.raises(ResultError, match="key 'created': expected a UTC time"):
        StatusChange(digest, "restored", "x", created)
    store.change_status(digest, "withdrawn", "A mistake.")
    assert [change.action for change in store.read_status_changes()[0]] == ["withdrawn"]
    (said,) = verify(store).problems.values()
    assert "key 'created': expected a UTC time" in said


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


def changed(track: str, **changes: Any) -> bytes:
    """A record's bytes with other values; metrics: of its first result, None to leave one out."""
    values = record_made(track=track).to_dict()
    metrics = {**values["results"][0]["metrics"], **changes.pop("metrics", {})}
    values["results"][0]["metrics"] = {key: value for key, value in metrics.items() if value is not None}
    return canonical({**values, **changes})


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (changed("slam", metrics={"score": 1e300}), "run 1 on val-01: metric 'score': expected 0 to 1"),
        (changed("segmentation", metrics={"union_px": -5.0}), "has union_px = -5: expected 0 or more"),
        (changed("segmentation", metrics={"union_px": None}), "has iou, but not union_px"),
        (changed("slam", created="9999-99-99 <b>"), "key 'created': expected a UTC time"),
        (changed("slam", created=""), "key 'created': expected a UTC time"),
        (changed("slam", supersedes="f" * 64), "the record that it supersedes, ffffffffffff, is missing"),
        (record_made().data.replace(b'"track":"slam"', b'"track":"golf"'), "track 'golf': expected one of"),
        (record_made().data.replace(b'"tier":', b'"tier":"reported","tier":'), "expected canonical JSON"),
        (record_made().data.replace(b'"tier":', b'"tier": '), "expected canonical JSON"),
        (record_made().data + b" ", "expected canonical JSON"),
        (b'{"a":' * 100_000, "expected JSON"),
    ],
)
def test_verify_names_a_record_that_cannot_be(tmp_path, data, said):
    store = RecordStore(tmp_path)
    store.add(record_made("another"))
    keep(store, "records", data)
    (found,) = verify(store).problems.values()
    assert said in found
    assert len(MemoryIndex(store).boards()) >= 1, "it stops no reader"


@pytest.mark.parametrize("key", ["t_s", "truth", "path", "error_m"])
@pytest.mark.parametrize("value", [1, [[]], ["a"]])
def test_verify_names_curves_that_cannot_be_drawn(tmp_path, key, value):
    store = RecordStore(tmp_path)
    curve = {"run": 0, "t_s": [0.0], "truth": [[0, 0, 0]], "path": [None], "error_m": [None]}
    store.add_curves(curves_document({"val-01": {**curve, key: value}}, "posyaw"))
    for sequences in ([], {"val-01": []}, {"val-01": {}}):
        store.add_curves({"format": CURVES, "align": "posyaw", "sequences": sequences})
    store.add_curves({"format": CURVES, "align": "posyaw"})
    assert len(verify(store).problems) == 5


def test_verify_names_a_folder_in_the_place_of_a_file(tmp_path):
    store = RecordStore(tmp_path)
    for kind in KINDS:
        (tmp_path / kind / f"{'0' * 64}.json").mkdir(parents=True)
    assert all("Is a directory" in said for said in verify(store).problems.values())
    assert len(verify(store).problems) == len(KINDS)


def keep(store: RecordStore, kind: str, data: bytes) -> None:
    """Put a file into a store under its own name, whatever is in it."""
    (store.folder / kind).mkdir(parents=True, exist_ok=True)
    (store.folder / kind / f"{sha256(data)}.json").write_bytes(data)
