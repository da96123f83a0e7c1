"""What a team publishes and withdraws, and what a crash between database and board leaves."""

from __future__ import annotations

import pytest

from oysterbench_leaderboard.submissions import sandbox, sandbox_worker
from oysterbench_leaderboard.submissions.refusals import Refusal
from tests.helpers.served import drain, make_service
from tests.helpers.serving import done, events, send


def test_a_record_comes_onto_the_board_when_its_team_says_so(service, tmp_path):
    told = []
    service.changed = lambda: told.append(1)
    id = done(service, tmp_path)
    with pytest.raises(Refusal, match="you have no such submission"):
        service.publish("others", id)
    found = service.publish("reef lab", id)
    assert service.store.digests() == [found.published]
    assert service.store.record(found.published).team == "reef lab"
    assert service.publish("reef lab", id).published == found.published
    assert len(told) == 1
    assert len(events(service, "published")) == 1


def test_only_what_is_done_is_published(service, tmp_path):
    made, _ = send(service, tmp_path)
    with pytest.raises(Refusal, match="this one is queued"):
        service.publish("reef lab", made.id)


def test_a_later_submission_takes_the_place_of_the_one_before(service, tmp_path):
    ids = [done(service, tmp_path, case) for case in range(3)]
    digests = [service.publish("reef lab", id).published for id in ids]
    records = [service.store.record(digest) for digest in digests]
    assert [record.supersedes for record in records] == ["", digests[0], digests[1]]
    service.withdraw("reef lab", ids[2])
    last = service.publish("reef lab", done(service, tmp_path, 3))
    other = service.publish("reef lab", done(service, tmp_path, 4, method="pike"))
    assert service.store.record(last.published).supersedes == digests[1]
    assert service.store.record(other.published).supersedes == ""


def test_paths_are_kept_with_records_of_public_splits_alone(service, tmp_path):
    found = service.publish("reef lab", done(service, tmp_path, split="pool-val"))
    record = service.store.record(found.published)
    assert set(service.store.curves(record.curves)["sequences"]) == {"pool-01", "pool-02"}
    assert "path_length_m" in record.results[0].metrics
    hidden = service.publish("reef lab", done(service, tmp_path))
    record = service.store.record(hidden.published)
    assert record.curves == ""
    assert "path_length_m" not in record.results[0].metrics


def test_a_withdrawal_is_announced_and_logged(service, tmp_path):
    found = service.publish("reef lab", done(service, tmp_path))
    gone = service.withdraw("reef lab", found.id, "a mistake in the calibration")
    assert (gone.state, gone.reason) == ("withdrawn", "a mistake in the calibration")
    (notice,) = service.store.status_changes()
    assert (notice.record, notice.action, notice.reason) == (found.published, "withdrawn", gone.reason)
    assert events(service, "withdrawn")[0]["who"] == "reef lab"
    assert service.withdraw("reef lab", found.id, "again") == gone
    assert service.store.digests() == [found.published], "records stay"
    with pytest.raises(Refusal, match="this one is withdrawn"):
        service.publish("reef lab", found.id)


def test_what_is_withdrawn_while_it_is_scored_stays_withdrawn(service, tmp_path, monkeypatch):
    made, _ = send(service, tmp_path)

    def withdrawn_meanwhile(job, *args):
        service.withdraw("reef lab", made.id)
        return sandbox.Ended(sandbox_worker.do(job), "", "")

    monkeypatch.setattr(sandbox, "run", withdrawn_meanwhile)
    drain(service)
    assert service.get("reef lab", made.id).state == "withdrawn"
    assert service.store.status_changes() == []


def test_what_a_crash_left_between_database_and_board_is_done_at_the_next_start(service, tmp_path):
    service._show = lambda record: None  # the server dies before
    service._announce = lambda found: None
    one = service.publish("reef lab", done(service, tmp_path, split="pool-val"))
    two = service.publish("reef lab", done(service, tmp_path, 1))
    service.withdraw("reef lab", two.id)
    assert service.store.digests() == []
    service.close()
    again = make_service(tmp_path)
    assert again.store.digests() == sorted([one.published, two.published])
    assert again.store.record(one.published).curves
    assert [notice.record for notice in again.store.status_changes()] == [two.published]
    again.close()
