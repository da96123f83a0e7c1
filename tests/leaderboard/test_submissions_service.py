"""What a server does with submissions, without a server: quotas, states, publication, and what a crash leaves."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace

import msgspec
import pytest
from sqlalchemy.exc import OperationalError

from oysterbench_leaderboard.submissions import queue
from oysterbench_leaderboard.submissions.accounts.tokens import issue, recognise
from oysterbench_leaderboard.submissions.database import SubmissionDatabase, find, submissions
from oysterbench_leaderboard.submissions.estimates import upload_of
from oysterbench_leaderboard.submissions.reading.refusals import FAILED, Refusal
from oysterbench_leaderboard.submissions.sandbox import sandbox
from oysterbench_leaderboard.submissions.settings import load_settings
from tests.helpers.pool import NAMES, answers, estimate, tum, zipped
from tests.helpers.served import FAST, drain, make_service
from tests.helpers.serving import FORM, events, send

# Sending:


def test_the_same_bytes_for_the_same_place_are_one_submission(service, tmp_path):
    first, new = send(service, tmp_path)
    assert new
    again, new = send(service, tmp_path)
    assert (again, new) == (first, False)
    other, new = send(service, tmp_path, form=replace(FORM, method="pike"))
    assert new
    assert other.id != first.id
    _, new = send(service, tmp_path, team="others")
    assert new
    assert len(events(service, "queued")) == 3
    assert len(list((service.settings.folder / "estimates").iterdir())) == 1, "kept once"


def test_bytes_that_are_kept_already_stay_the_same_file_unless_they_were_changed(service, tmp_path):
    made, _ = send(service, tmp_path)
    kept = service.settings.folder / "estimates" / made.digest
    with open(kept, "rb") as being_read:
        send(service, tmp_path, form=replace(FORM, method="pike"))
        assert os.path.samestat(kept.stat(), os.fstat(being_read.fileno()))
    assert not list(service.incoming.iterdir())
    kept.write_bytes(b"damaged")
    send(service, tmp_path, form=replace(FORM, method="perch"))
    assert upload_of(kept).digest == made.digest


def test_quotas_count_what_was_accepted_in_a_day_and_on_a_split(service, tmp_path):
    service.settings = msgspec.structs.replace(service.settings, per_day=2, per_split=3)
    send(service, tmp_path, 1)
    bad = service.incoming / "bad"
    bad.write_bytes(b"1 2 3\n")
    with pytest.raises(Refusal, match="has 2 sequences, and one file does not say"):
        service.submit("reef lab", FORM, upload_of(bad))
    service.clock.now += 3600
    send(service, tmp_path, 2)
    with pytest.raises(Refusal, match="2 submissions in 24 hours are the limit for a team") as refused:
        send(service, tmp_path, 3)
    assert 82_000 < refused.value.retry_s <= 82_801
    send(service, tmp_path, 3, team="others")
    service.clock.now += 86_400
    send(service, tmp_path, 3)
    with pytest.raises(Refusal, match="3 submissions to pool-test are the limit for a team"):
        send(service, tmp_path, 4)
    send(service, tmp_path, 4, form=replace(FORM, split="pool-val"))


def test_by_its_digest_what_is_known_or_too_much_is_answered_before_it_is_sent(service, tmp_path):
    made, _ = send(service, tmp_path)
    service.settings = msgspec.structs.replace(service.settings, per_day=1)
    form, _ = service.check_form(FORM)
    assert service.announced("reef lab", form, made.digest) == made
    with pytest.raises(Refusal, match="1 submissions in 24 hours are the limit for a team"):
        service.announced("reef lab", form, "0" * 64)
    assert service.announced("others", form, made.digest) is None, "what another team has sent is not told"
    assert len(events(service, "queued")) == 1


# Scoring:


def test_what_is_queued_is_scored_once_and_stays_private(service, tmp_path):
    made, _ = send(service, tmp_path)
    assert drain(service) == 1
    assert drain(service) == 0
    found = service.get("reef lab", made.id)
    assert (found.state, found.attempt, found.reason) == ("done", 1, "")
    record = service.record(found)
    assert (record.method, record.team, record.tier, record.split) == ("carp", "reef lab", "scored", "pool-test")
    assert record.created == found.created
    assert set(record.estimates.values()) == {found.digest}
    assert record.curves == ""
    assert all(not result.hardware and result.created == found.created for result in record.results)
    assert service.store.digests() == []
    with pytest.raises(Refusal, match="you have no such submission"):
        service.get("others", made.id)


def test_a_second_scoring_gives_the_same_bytes(service, tmp_path):
    made, _ = send(service, tmp_path)
    drain(service)
    first = service.get("reef lab", made.id).record
    with service.database.writing() as connection:
        queue.change(connection, made.id, service.now(), state="queued")
    service.clock.now += 1000
    drain(service)
    assert service.get("reef lab", made.id).record == first


def test_one_server_dispatches_and_another_one_takes_over_what_it_had_begun(service, tmp_path):
    made, _ = send(service, tmp_path)
    with service.database.alone() as first:
        lost = queue.claim(service, first)
        other = make_service(tmp_path, **FAST)
        with other.database.alone() as second:
            assert second is None, "while the first one lives"
    assert service.get("reef lab", made.id).state == "running"
    with other.database.alone() as second:
        queue.recover(other, second)
        mine = queue.claim(other, second)
        assert (mine.id, mine.attempt) == (made.id, 2)
        assert not queue.finish(service, second, lost, "done", record="0" * 64), "too late"
        assert queue.finish(other, second, mine, "failed", reason="x")
        assert not queue.finish(other, second, mine, "done", record="0" * 64), "twice"
    assert [len(events(service, what)) for what in ("done", "failed")] == [0, 1]
    other.close()


def test_what_was_begun_most_often_comes_last(service, tmp_path):
    first, _ = send(service, tmp_path, 1)
    with service.database.alone() as connection:
        queue.claim(service, connection)
        queue.recover(service, connection)
        service.clock.now += 100
        second, _ = send(service, tmp_path, 2)
        assert [queue.claim(service, connection).id for _ in range(2)] == [second.id, first.id]


@pytest.mark.parametrize(
    ("cause", "reason"),
    [("time", "scoring exceeded the time limit"), ("memory", "memory limit"), ("crash", "ended without a result")],
)
def test_a_scoring_without_an_answer_fails_with_a_sentence_of_the_list(service, tmp_path, monkeypatch, cause, reason):
    message = "Traceback: truth at /secret/place is 1.234"
    made, _ = send(service, tmp_path)
    monkeypatch.setattr(sandbox, "run", lambda *args: sandbox.Ended(None, cause, message))
    tries = drain(service)
    found = service.get("reef lab", made.id)
    assert found.state == "failed"
    assert reason in found.reason
    assert found.reason in FAILED.values()
    assert tries == (service.settings.attempts if cause == "crash" else 1)
    assert "/secret/place" in (service.settings.folder / "private.log").read_text()
    assert "/secret/place" not in str(events(service))


def test_a_task_that_times_out_by_itself_has_as_many_attempts_as_any_other(service, tmp_path, monkeypatch):
    """It is no scoring that is still going on, which goes back into the queue as often as it takes."""

    def late(*args):
        raise TimeoutError("the store did not answer")

    made, _ = send(service, tmp_path)
    monkeypatch.setattr(sandbox, "run", late)
    assert drain(service) == service.settings.attempts
    assert service.get("reef lab", made.id).state == "failed"


def test_what_failed_by_the_servers_fault_may_be_sent_again_after_an_hour(service, tmp_path, monkeypatch):
    made, _ = send(service, tmp_path)
    with monkeypatch.context() as broken:
        broken.setattr(sandbox, "run", lambda *args: sandbox.Ended(None, "crash", ""))
        drain(service)
    assert send(service, tmp_path) == (service.get("reef lab", made.id), False)
    service.clock.now += 3601
    again, taken = send(service, tmp_path)
    assert (again.id, again.state, taken) == (made.id, "queued", True)
    assert drain(service) == 1
    assert service.get("reef lab", made.id).state == "done"


def test_what_failed_by_its_own_fault_stays_so(service, tmp_path, monkeypatch):
    made, _ = send(service, tmp_path)
    with monkeypatch.context() as slow:
        slow.setattr(sandbox, "run", lambda *args: sandbox.Ended(None, "time", ""))
        drain(service)
    service.clock.now += 7200
    assert send(service, tmp_path) == (service.get("reef lab", made.id), False)


def test_nothing_that_can_be_scored_is_a_failure_and_a_reason_that_sequences_share_is_told_once(service, tmp_path):
    large = {
        f"{name}.tum": tum(replace(e := estimate(k), positions=1000 * e.positions), tmp_path)
        for k, name in enumerate(NAMES)
    }
    file = service.incoming / "large"
    file.write_bytes(zipped(large))
    made, _ = service.submit("reef lab", FORM, upload_of(file))
    drain(service)
    found = service.get("reef lab", made.id)
    assert found.state == "failed"
    assert found.reason == (
        "no sequence could be scored; pool-01, pool-02: the path is refused: its positions are not in metres"
    )


def test_a_file_without_a_submission_is_no_harm(service, tmp_path):
    """A crash after the file was kept, before it was counted: the sender has no answer, and sends it again."""
    file = service.incoming / "x"
    file.write_bytes(answers(tmp_path))
    service.estimates.keep(upload_of(file))
    made, new = send(service, tmp_path)
    assert new
    assert drain(service) == 1
    assert service.get("reef lab", made.id).state == "done"


# State:


def test_the_database_keeps_what_it_has_said(service, tmp_path):
    made, _ = send(service, tmp_path)
    with service.database.reading() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 2
    database = SubmissionDatabase(service.settings)
    with database.reading() as connection:
        assert [one.id for one in find(connection, submissions.c.team == "reef lab")] == [made.id]
    database.close()


def test_two_hosts_share_a_queue_in_postgresql(laid, tmp_path, here, postgres):
    """What either of them takes in, the one that dispatches scores, once; where its connection breaks, the other."""
    shutil.copytree(laid / "splits", tmp_path / "splits")
    hosts = [make_service(tmp_path, database=postgres.replace("+psycopg", ""), **FAST) for _ in range(2)]
    issue(hosts[0].database, "reef lab")
    made = [send(hosts[k % 2], tmp_path, k)[0].id for k in range(6)]
    assert send(hosts[1], tmp_path, 0) == (hosts[1].get("reef lab", made[0]), False)
    with hosts[0].database.alone() as first:
        begun = queue.claim(hosts[0], first)
        with hosts[1].database.alone() as second:
            assert second is None
        first.connection.dbapi_connection.close()
        assert drain(hosts[1]) == 6
        with pytest.raises(OperationalError):
            queue.finish(hosts[0], first, begun, "failed", reason="x")
    found = hosts[0].of_team("reef lab")
    assert sorted(one.id for one in found) == sorted(made)
    assert {(one.state, one.attempt) for one in found} == {("done", 1 + (one.id == begun.id)) for one in found}
    assert sorted(event["submission"] for event in events(hosts[1], "done")) == sorted(made)
    published = hosts[1].publish("reef lab", made[0]).published
    assert hosts[0].store.digests() == [published]
    for host in hosts:
        host.close()


def test_a_token_with_odd_characters_is_unknown_in_postgresql(tmp_path, postgres):
    database = SubmissionDatabase(load_settings(tmp_path, database=postgres.replace("+psycopg", "")))
    with database.reading() as connection:
        for odd in ("oyb_\0_x", "oyb_\u00e9_x", "oyb_1_\udc80"):
            assert recognise(connection, odd) is None
    database.close()
