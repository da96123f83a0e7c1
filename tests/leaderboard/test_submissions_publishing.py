"""What a team publishes and withdraws, and what a crash between database and board leaves."""

from __future__ import annotations

import errno
import shutil
import threading
import time
from dataclasses import replace

import pytest
from sqlalchemy import text

from oysterbench.hub.canonical import parse
from oysterbench.results.records import ResultRecord, write_results
from oysterbench_leaderboard.boards.ranking import withdrawn
from oysterbench_leaderboard.storage.store import StatusChange
from oysterbench_leaderboard.submissions import queue
from oysterbench_leaderboard.submissions.accounts.tokens import issue
from oysterbench_leaderboard.submissions.database import change
from oysterbench_leaderboard.submissions.estimates import upload_of
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.sandbox import sandbox, sandbox_worker
from oysterbench_leaderboard.submissions.words import Form
from tests.helpers.served import FAST, drain, make_service
from tests.helpers.serving import done, events, send
from tests.helpers.waiting import until


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


def test_reported_results_take_no_place_of_scored_ones(service, tmp_path):
    scored = service.publish("reef lab", done(service, tmp_path, split="pool-val")).published
    file = service.incoming / "results.json"
    results = service.store.record(scored).results
    write_results(file, [replace(result, created="2025-01-01T00:00:00Z") for result in results])
    made, _ = service.submit("reef lab", Form("carp", "pool-val"), upload_of(file))
    drain(service)
    with pytest.raises(Refusal, match=f"do not replace your scored record {scored[:8]} of carp: withdraw that first"):
        service.publish("reef lab", made.id)
    assert service.store.digests() == [scored]


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


def test_a_team_does_not_replace_the_operators_reason_by_its_own(service, tmp_path):
    found = service.publish("reef lab", done(service, tmp_path))
    service.store.change_status(found.published, "withdrawn", "The estimates were made from the truth.")
    service.clock.now = time.time() + 3600
    gone = service.withdraw("reef lab", found.id, "Replaced by a better version soon")
    assert gone.state == "withdrawn"
    service.close()
    again = make_service(tmp_path)
    assert [each.reason for each in again.store.status_changes()] == ["The estimates were made from the truth."]
    again.close()


def test_what_is_withdrawn_while_it_is_scored_stays_withdrawn(service, tmp_path, monkeypatch):
    made, _ = send(service, tmp_path)

    def withdrawn_meanwhile(job, *args):
        service.withdraw("reef lab", made.id)
        return sandbox.Ended(sandbox_worker.do(job), "", "")

    monkeypatch.setattr(sandbox, "run", withdrawn_meanwhile)
    drain(service)
    assert service.get("reef lab", made.id).state == "withdrawn"
    assert service.store.status_changes() == []


def rescored(service, digest: str, evaluator: str = "slam 99") -> str:
    """Append what `leaderboard rescore` makes of a record; return its digest."""
    old = service.store.record(digest)
    results: list[ResultRecord] = [replace(result, evaluator_version=evaluator) for result in old.results]
    made = replace(old, results=results, supersedes=digest, reason="Rescored.", created=service.now())
    return service.store.add(made)


def test_a_withdrawal_takes_what_was_scored_again_from_the_upload_off_the_board(service, tmp_path):
    one = service.publish("reef lab", done(service, tmp_path))
    other = service.publish("others", done(service, tmp_path, team="others"))
    again = rescored(service, one.published)
    twice = rescored(service, again, "slam 100")
    rescored(service, other.published)
    two = service.publish("reef lab", done(service, tmp_path, 1))
    service.withdraw("reef lab", one.id)
    assert withdrawn(service.store.status_changes()) == {one.published, again, twice}
    assert two.published in service.store.digests()


def test_what_is_published_after_a_rescoring_takes_the_place_of_the_rescored_record(service, tmp_path):
    first, second = done(service, tmp_path), done(service, tmp_path, 1)
    published = service.publish("reef lab", first).published
    service.clock.now += 60
    again = rescored(service, published, service.store.record(published).evaluator_version)
    last = service.publish("reef lab", second).published
    assert service.store.record(last).supersedes == again


def test_what_could_not_be_written_to_the_board_is_written_when_asked_again(service, tmp_path, monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    told = []
    service.changed = lambda: told.append(1)
    id = done(service, tmp_path)
    for ask, kind in ((service.publish, "records"), (service.withdraw, "changes")):
        with monkeypatch.context() as patch:
            patch.setattr(service.store, "_keep", full)
            with pytest.raises(OSError, match="No space left"):
                ask("reef lab", id)
        assert service.store.names(kind) == told == []
        ask("reef lab", id)
        assert (len(service.store.names(kind)), told) == (1, [1])
        told.clear()


def begun(service, work) -> threading.Thread:
    """Start work in a thread; return once it has ended, or waits for another transaction."""
    thread = threading.Thread(target=work)
    thread.start()
    waiting = text("SELECT count(*) FROM pg_stat_activity WHERE wait_event_type = 'Lock'")

    def settled() -> bool:
        with service.database.reading() as connection:
            return not thread.is_alive() or connection.execute(waiting).scalar_one() > 0

    until(settled)
    return thread


@pytest.mark.slow
def test_on_postgresql_a_withdrawal_waits_for_what_another_host_does_to_the_submission(
    laid, tmp_path, here, postgres, monkeypatch
):
    shutil.copytree(laid / "splits", tmp_path / "splits")
    one, two = (make_service(tmp_path, database=postgres.replace("+psycopg", ""), **FAST) for _ in range(2))
    issue(one.database, "reef lab")
    published, lost = done(one, tmp_path), send(one, tmp_path, 1)[0].id
    threads = []

    def withdraws_before(step, id):
        def step_after(*args, **values):
            threads.append(begun(two, lambda: two.withdraw("reef lab", id)))
            return step(*args, **values)

        return step_after

    monkeypatch.setattr(one.scored, "add", withdraws_before(one.scored.add, published))
    digest = one.publish("reef lab", published).published
    with one.database.alone() as connection:
        queue.claim(one, connection)
        monkeypatch.setattr(queue, "change", withdraws_before(queue.change, lost))
        queue.recover(one, connection)
    for thread in threads:
        thread.join()
    assert withdrawn(one.store.status_changes()) == {digest}
    assert [found.state for found in one.of_team("reef lab")] == ["withdrawn", "withdrawn"]
    one.close()
    two.close()


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


def fail(*given):
    """Stand for what writes to a board that is not there."""
    raise PermissionError


def test_what_is_published_already_is_so_still_when_the_board_was_out_of_reach(service, tmp_path, monkeypatch):
    one = service.publish("reef lab", done(service, tmp_path))
    there = service.store.folder / "records"
    with monkeypatch.context() as closed:
        closed.setattr(service.store, "add", fail)
        away = there.rename(there.with_name("away"))
        with pytest.raises(PermissionError):
            service.publish("reef lab", one.id)
        away.rename(there)
    service.withdraw("reef lab", one.id)
    assert withdrawn(service.store.status_changes()) == {one.published}


def test_what_is_on_the_board_is_published_though_writing_it_seemed_to_fail(service, tmp_path, monkeypatch):
    told, add = [], service.store.add

    def add_and_fail(record):
        add(record)
        fail()

    service.changed = lambda: told.append(1)
    monkeypatch.setattr(service.store, "add", add_and_fail)
    one = service.publish("reef lab", done(service, tmp_path))
    assert service.store.digests() == [one.published] == [service.get("reef lab", one.id).published]
    assert told == [1]


def test_what_is_withdrawn_while_its_publication_fails_is_withdrawn_where_it_comes_yet(service, tmp_path, monkeypatch):
    id = done(service, tmp_path)

    def withdraw_and_fail(record):
        service.withdraw("reef lab", id)
        fail()

    with monkeypatch.context() as closed:
        closed.setattr(service.store, "add", withdraw_and_fail)
        with pytest.raises(PermissionError):
            service.publish("reef lab", id)
    published = service.withdraw("reef lab", id).published
    assert [change.record for change in service.store.status_changes()] == [published]


def test_what_was_scored_again_before_or_after_a_withdrawal_is_withdrawn_at_the_next_start(service, tmp_path):
    one = service.publish("reef lab", done(service, tmp_path))
    before = rescored(service, one.published)
    with service.database.writing() as connection:  # as servers did that marked what was published alone
        change(connection, one.id, service.now(), state="withdrawn", reason="a mistake", notice=service.now())
    service.store.add_status_change(StatusChange(one.published, "withdrawn", "a mistake", service.now()))
    two = service.publish("others", done(service, tmp_path, team="others"))
    service.withdraw("others", two.id)
    after = rescored(service, two.published)
    assert withdrawn(service.store.status_changes()) == {one.published, two.published}
    service.close()
    for _ in range(2):
        again = make_service(tmp_path)
        assert withdrawn(again.store.status_changes()) == {one.published, before, two.published, after}
        assert len(again.store.status_changes()) == 4
        again.close()


def test_what_was_restored_is_not_withdrawn_again_at_the_next_start(service, tmp_path):
    one = service.publish("reef lab", done(service, tmp_path))
    service.withdraw("reef lab", one.id)
    service.store.change_status(one.published, "restored", "a misunderstanding")
    rescored(service, one.published)
    service.close()
    again = make_service(tmp_path)
    assert withdrawn(again.store.status_changes()) == set()
    again.close()


def test_what_was_restored_can_still_be_withdrawn(service, tmp_path):
    one = service.publish("reef lab", done(service, tmp_path))
    service.store.add_status_change(StatusChange(one.published, "restored", "a misunderstanding", service.now()))
    service.clock.now += 60
    service.withdraw("reef lab", one.id)
    assert withdrawn(service.store.status_changes()) == {one.published}


def test_a_damaged_scored_record_keeps_no_server_from_starting(service, tmp_path):
    bad, good = (
        service.publish("reef lab", done(service, tmp_path, k, method=name)).published
        for k, name in enumerate(("pike", "cod"))
    )
    (service.scored.folder / "records" / f"{bad}.json").write_text("{}")
    for digest in (bad, good):
        (service.store.folder / "records" / f"{digest}.json").unlink()
    again = make_service(tmp_path, **FAST)
    assert again.store.digests() == [good], "what a crash left undone is done for the others"
    assert "was not put on the board again" in (tmp_path / "private" / "private.log").read_text()
    again.close()


def test_a_damaged_scored_record_is_read_from_the_board_and_keeps_no_later_one_from_it(service, tmp_path):
    first, second, third = (done(service, tmp_path, k) for k in range(3))
    whole = service.record(service.get("reef lab", first))
    old = service.publish("reef lab", first).published
    (service.scored.folder / "records" / f"{old}.json").write_text("{}")
    assert service.record(service.get("reef lab", first)) == whole
    new = service.publish("reef lab", second).published
    assert service.store.record(new).supersedes == old
    for folder in (service.scored.folder, service.store.folder):
        (folder / "records" / f"{new}.json").write_text("{}")
    assert service.publish("reef lab", third).published in service.store.digests()


@pytest.mark.parametrize("on_board", [True, False])
def test_damaged_curves_keep_no_record_off_the_board(service, tmp_path, on_board):
    """The board's own serve as well; without any, the record is there and nothing is drawn."""
    id = done(service, tmp_path, split="pool-val")
    curves = service.record(service.get("reef lab", id)).curves
    whole = (service.scored.folder / "curves" / f"{curves}.json").read_bytes()
    (service.scored.folder / "curves" / f"{curves}.json").write_bytes(whole[:-1])
    if on_board:
        service.store.add_curves(parse(whole, "curves"))
    found = service.publish("reef lab", id).published
    assert found in service.store.digests()
    assert service.store.names("curves") == ([curves] if on_board else [])
    assert ("without its drawing" in (tmp_path / "private" / "private.log").read_text()) != on_board
    later = done(service, tmp_path, split="pool-val", method="pike")
    assert service.record(service.get("reef lab", later)).curves == curves, "the same, which are written again"
    assert (service.scored.folder / "curves" / f"{curves}.json").read_bytes() == whole
