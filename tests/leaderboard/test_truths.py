"""Records of one board are compared, so they must have been scored against one ground truth."""

from __future__ import annotations

import asyncio
import threading
from dataclasses import replace
from functools import partial

import pytest

from oysterbench.core.errors import ResultError
from oysterbench.results.records import write_results
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.publishing import truths
from oysterbench_leaderboard.publishing.publish import publish
from oysterbench_leaderboard.publishing.truths import DO, Stated, contradicted, current, held_since, stated_in
from oysterbench_leaderboard.publishing.verifying import verify
from oysterbench_leaderboard.site.export import export
from oysterbench_leaderboard.site.server import application
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import StatusChange
from oysterbench_leaderboard.submissions.accounts.auth import Auth
from oysterbench_leaderboard.submissions.estimates import upload_of
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.words import Form
from tests.helpers.records_made import record_made
from tests.helpers.served import drain
from tests.helpers.serving import done
from tests.helpers.site_made import Client

ODD = "val-01: scored against another ground truth than record {}, carp by reef lab"


def against(record: Record, digest: str = "0" * 64) -> Record:
    """The record as if it had been scored against another ground truth."""
    return replace(record, results=tuple(replace(result, truth_digest=digest) for result in record.results))


FORGED = against(record_made("forged", "somebody", 0.9, tier="reported", created="2020-01-01T00:00:00Z"))


def test_a_record_has_one_ground_truth_of_each_sequence():
    first, *others = record_made("carp", runs=2).results
    with pytest.raises(ResultError, match="expected one ground truth of a sequence, got several"):
        replace(record_made("carp"), results=[replace(first, truth_digest="0" * 64), *others])


@pytest.mark.parametrize("tier", ["reported", "baseline"])
def test_a_method_may_be_made_again_on_another_ground_truth_and_what_it_replaces_counts_no_more(tier, store):
    wrong = against(record_made("carp", tier=tier, created="2026-11-02T00:00:00Z"))
    publish(store, [(wrong, None)])
    publish(store, [(record_made("carp", "reef lab", 0.7, tier=tier, created="2026-11-03T00:00:00Z"), None)])
    publish(store, [(record_made("cod", "reef lab", 0.6, tier=tier, created="2026-11-04T00:00:00Z"), None)])
    assert not [text for text in verify(store).problems.values() if "ground truth" in text]
    with pytest.raises(ResultError, match="another ground truth"):
        publish(store, [(against(record_made("eel", tier=tier)), None)])


def test_what_is_added_has_the_ground_truth_of_the_board(store):
    carp = record_made("carp", tier="baseline")
    publish(store, [(carp, None)])
    with pytest.raises(ResultError, match=ODD.format(carp.digest[:8])):
        publish(store, [(FORGED, None)])
    with pytest.raises(ResultError, match="val-01: scored against another ground truth"):
        publish(store, [(record_made("cod"), None), (against(record_made("eel")), None)])
    assert store.digests() == [carp.digest]
    publish(store, [(against(record_made("cod"), ""), None)])  # says nothing of it
    store.change_status(carp.digest, "withdrawn", "a mistake")
    publish(store, [(FORGED, None)])


def test_what_anybody_wrote_down_keeps_no_ranked_record_off_the_board(store):
    publish(store, [(FORGED, None)])
    with pytest.raises(ResultError, match="val-01: scored against another ground truth than record"):
        publish(store, [(record_made("cod", tier="reported"), None)])
    publish(store, [(record_made("carp"), None)])


def test_what_comes_with_a_ranked_record_has_to_agree_with_reported_ones_all_the_same(store):
    publish(store, [(record_made("carp", tier="reported"), None)])
    with pytest.raises(ResultError, match="carp by reef lab: render the split again"):
        publish(store, [(against(record_made("cod"), ""), None), (FORGED, None)])


@pytest.mark.parametrize("met", [True, False])
def test_a_record_that_comes_back_counts_as_if_it_had_come_then(met, store):
    """The board agreed on a ground truth without it; but it was there before what came after that."""
    made = partial(record_made, tier="reported")
    publish(store, [(FORGED, None)])
    ((_, right, _),) = publish(store, [(made("forged", "somebody", 0.8, created="2020-01-02T00:00:00Z"), None)])
    if met:
        publish(store, [(made("cod", created="2020-01-03T00:00:00Z"), None)])
    store.add_status_change(StatusChange(right, "withdrawn", "by the team", "2020-01-04T00:00:00Z"))
    if not met:
        store.add(made("cod", created="2020-01-05T00:00:00Z"))
    ((file, why),) = verify(store).problems.items()
    assert (file == f"records/{FORGED.digest}.json") is met
    assert ("cod by reef lab" if met else "forged by somebody") in why
    new = against(made("eel", created="2020-01-06T00:00:00Z")) if met else made("eel", created="2020-01-06T00:00:00Z")
    with pytest.raises(ResultError, match="have it withdrawn"):
        publish(store, [(new, None)])


def test_a_record_was_absent_whatever_was_in_its_place_and_where_it_was_withdrawn_itself(store):
    made = partial(record_made, tier="reported")
    forged = store.add(against(made("forged", "somebody", created="2020-01-02T00:00:00Z")))
    named = replace(made("forged", "somebody", 0.8, created="2020-01-01T00:00:00Z"), supersedes=forged)
    store.add(made("cod", created="2020-01-03T00:00:00Z"))
    instead = store.add(named)  # made before the one that it replaces, and published after it
    store.add_status_change(StatusChange(instead, "withdrawn", "by the team", "2020-01-04T00:00:00Z"))
    assert list(verify(store).problems) == [f"records/{forged}.json"]
    other = store.add(against(made("eel", "others", created="2020-01-01T00:00:00Z")))
    for action, day in (("withdrawn", 2), ("restored", 5)):
        store.add_status_change(StatusChange(other, action, "a mistake", f"2020-01-0{day}T12:00:00Z"))
    assert sorted(verify(store).problems) == sorted([f"records/{forged}.json", f"records/{other}.json"])


def test_a_ground_truth_is_believed_from_when_it_came_whichever_records_have_said_so_since(store):
    """An invented one that came back later keeps nobody from replacing a record, and stays behind what came after."""
    made = partial(record_made, tier="reported")
    forged = store.add(against(made("forged", "somebody", created="2020-01-01T00:00:00Z")))
    ((_, instead, _),) = publish(store, [(made("forged", "somebody", 0.8, created="2020-01-02T00:00:00Z"), None)])
    publish(store, [(made("carp", created="2020-01-03T00:00:00Z"), None)])
    store.add_status_change(StatusChange(instead, "withdrawn", "by the team", "2020-01-04T00:00:00Z"))
    ((_, carp, _),) = publish(store, [(made("carp", skill=0.7, created="2020-01-05T00:00:00Z"), None)])
    publish(store, [(made("cod", created="2020-01-06T00:00:00Z"), None)])
    store.add_status_change(StatusChange(carp, "withdrawn", "by the team", "2020-01-07T00:00:00Z"))
    publish(store, [(made("cod", skill=0.7, created="2020-01-08T00:00:00Z"), None)])
    assert list(verify(store).problems) == [f"records/{forged}.json"]


def test_a_ground_truth_is_believed_whichever_others_a_record_names(store):
    """An invented one that came back is not believed because a record has named more sequences since."""

    def first(record):
        return replace(record, results=record.results[:1])

    made = partial(record_made, tier="reported")
    ((_, forged, _),) = publish(store, [(first(FORGED), None)])
    ((_, instead, _),) = publish(store, [(made("forged", "somebody", created="2020-01-02T00:00:00Z"), None)])
    publish(store, [(first(made("carp", created="2020-01-03T00:00:00Z")), None)])
    store.add_status_change(StatusChange(instead, "withdrawn", "by the team", "2020-01-04T00:00:00Z"))
    publish(store, [(made("carp", skill=0.7, created="2020-01-05T00:00:00Z"), None)])
    publish(store, [(first(made("cod", created="2020-01-06T00:00:00Z")), None)])
    assert list(verify(store).problems) == [f"records/{forged}.json"]


def test_since_when_a_ground_truth_is_there_takes_no_longer_for_the_many_methods_of_a_team(monkeypatch):
    several = [record_made(f"carp{k}", created=f"2020-01-01T00:00:{k:02d}Z") for k in range(30)]
    seen, states = [], truths.states
    monkeypatch.setattr(
        truths, "states", lambda claims, gone: states([seen.append(one) or one for one in claims], gone)
    )
    found = held_since([Stated.of(record.digest, record) for record in several], [])
    assert set(found.values()) == {("2020-01-01T00:00:00Z", False)}
    assert len(seen) == len(several)


def test_a_record_was_absent_while_one_that_names_it_was_there_under_another_method(store):
    made = partial(record_made, tier="reported")
    forged = store.add(FORGED)
    renamed = replace(made("renamed", "somebody", created="2020-01-02T00:00:00Z"), supersedes=forged)
    store.add(renamed)
    store.add(made("cod", created="2020-01-03T00:00:00Z"))
    store.add_status_change(StatusChange(renamed.digest, "withdrawn", "by the team", "2020-01-04T00:00:00Z"))
    assert list(verify(store).problems) == [f"records/{forged}.json"]


def test_a_reported_record_that_was_withdrawn_was_never_in_the_place_of_a_ranked_one(store):
    carp = store.add(record_made("carp", created="2020-01-01T00:00:00Z"))
    store.add(against(record_made("cod", created="2020-01-02T00:00:00Z")))
    reported = store.add(record_made("carp", tier="reported", created="2020-01-03T00:00:00Z"))
    store.change_status(reported, "withdrawn", "a mistake")
    (why,) = verify(store).problems.values()
    assert f"than record {carp[:8]}" in why


def test_verify_names_the_record_of_another_ground_truth_until_it_is_withdrawn(store):
    carp, forged = store.add(record_made("carp")), store.add(FORGED)
    store.add(against(record_made("carp", evaluator="slam 2")))  # on another board
    why = ODD.format(carp[:8])
    assert verify(store).problems == {f"records/{forged}.json": f"{why}: withdraw the one that is wrong"}
    store.change_status(forged, "withdrawn", "invented")
    assert verify(store).problems == {}


@pytest.fixture
def site(store, tmp_path):
    """Three records, one of them forged."""
    for record in (record_made("carp"), record_made("cod", skill=0.5), FORGED):
        results = [replace(one, conditions={"disturbance": "silt", "strength": 1}) for one in record.results]
        calm = replace(results[0], conditions={"disturbance": "none", "strength": 0})
        store.add(replace(record, results=[calm, *results[1:]]))
    return Site(open_index(store, str(tmp_path / "index.sqlite")))


def test_comparisons_with_it_are_refused_in_one_line(site):
    client = Client(application(site, fresh_s=0.0))
    answers = [client.get(f"/compare.json?{asked}") for asked in ("a=forged&b=carp", "r=carp&r=cod&r=forged")]
    assert client.get("/compare.json?a=carp&b=cod").status == 200
    board = client.get("/boards/slam/slam-val")
    client.close()
    for answer in answers:
        assert answer.status == 409
        assert answer.json()["error"].startswith(
            "these records may not be compared: sequence 'val-01' was scored against 2 different truths"
        )
    assert board.status == 200
    assert 'data-label="carp"' in board.text
    assert 'data-label="forged"' not in board.text


def test_the_records_of_others_are_read_for_one_page_only(site, monkeypatch):
    read: list[str] = []
    monkeypatch.setattr(site.store, "digests", lambda: read.append("all") or [])
    client = Client(application(site, fresh_s=0.0))
    pages = [client.get(f"/boards/slam/slam-val?q={words}").status for words in ("", "o", "d")]
    client.close()
    assert (pages, read) == ([200] * 3, ["all"])


def test_the_files_of_the_site_are_written_without_its_comparisons(site, tmp_path):
    said: list[tuple[str, str]] = []
    export(site, tmp_path / "site", report=lambda *of: said.append(of))
    ((digest, why),) = said
    assert site.record(digest).method == "forged"
    assert why.startswith("its comparisons: val-01: scored against another ground truth than record")
    pairs = {path.parent.name for path in (tmp_path / "site" / "compare").glob("*/index.html")}
    assert len(pairs) == 2
    assert not any(digest[:16] in name for name in pairs)
    assert (tmp_path / "site" / "records" / digest / "index.html").is_file()


# Submissions to a split that is not rendered on the server:


@pytest.fixture
def results(service, tmp_path):
    """Results of an honest team, by the server that has the ground truth; afterwards, it has none."""
    id = done(service, tmp_path, split="pool-val")
    found = service.record(service.get("reef lab", id)).results
    splits = service.catalogue.splits
    splits["pool-val"] = replace(splits["pool-val"], truth={})
    return [replace(result, created="2025-01-01T00:00:00Z") for result in found]


def reported(service, team: str, results) -> str:
    """Name of a submission of results, scored."""
    file = service.incoming / "results.json"
    write_results(file, results)
    made, _ = service.submit(team, Form("pike", "pool-val"), upload_of(file))
    drain(service)
    return made.id


def test_the_first_ground_truth_that_is_reported_is_kept_and_another_refused(service, results):
    invented = [replace(result, truth_digest="0" * 64) for result in results]
    with pytest.raises(Refusal, match="expected one ground truth of a sequence, got several"):
        reported(service, "others", [results[0], replace(invented[0], run=1)])
    early = reported(service, "others", invented)
    published = service.publish("reef lab", reported(service, "reef lab", results)).published
    odd = f"pool-01: scored against another ground truth than record {published[:8]}, pike by reef lab: {DO}"
    with pytest.raises(Refusal, match=odd):
        service.publish("others", early)
    late = service.get("others", reported(service, "others", [replace(one, seed=5) for one in invented]))
    assert (late.state, late.reason) == ("failed", odd)
    assert service.store.digests() == [published]


def fail(*given):
    """Stand for what writes to a board whose folder is closed."""
    raise PermissionError


def test_a_publication_that_failed_is_checked_again_when_it_is_completed(service, results, monkeypatch):
    early = reported(service, "others", [replace(result, truth_digest="0" * 64) for result in results])
    honest = reported(service, "reef lab", results)
    with monkeypatch.context() as closed:
        closed.setattr(service.store, "add", fail)
        with pytest.raises(PermissionError):
            service.publish("others", early)
    published = service.publish("reef lab", honest).published
    with pytest.raises(Refusal, match=DO):
        service.publish("others", early)
    service._settle()
    assert service.store.digests() == [published]


def test_a_publication_that_a_crash_cut_short_is_checked_again_when_it_is_completed(service, results, monkeypatch):
    early = reported(service, "others", [replace(result, truth_digest="0" * 64) for result in results])
    honest = reported(service, "reef lab", results)
    with monkeypatch.context() as killed:
        killed.setattr(service, "_show", lambda record: None)
        service.publish("others", early)
    published = service.publish("reef lab", honest).published
    with pytest.raises(Refusal, match=DO):
        service.publish("others", early)
    assert service.store.digests() == [published]


def test_a_record_comes_back_when_the_board_is_told_of_the_withdrawal(service, results, monkeypatch):
    forged = reported(service, "others", [replace(result, truth_digest="0" * 64) for result in results])
    service.publish("others", forged)
    service.clock.now += 60
    instead = reported(service, "others", [replace(result, seed=5) for result in results])
    service.publish("others", instead)
    service.clock.now += 60
    with monkeypatch.context() as closed:
        closed.setattr(service.store, "add_status_change", fail)
        with pytest.raises(PermissionError):
            service.withdraw("others", instead)
    service.clock.now += 60
    service.publish("reef lab", reported(service, "reef lab", results))
    service.clock.now += 60
    service.withdraw("others", instead)
    every, changes = stated_in(service.store)
    odd = contradicted(current(every, changes), lambda: held_since(every, changes))
    assert list(odd) == [service.get("others", forged).published]


def test_of_two_that_are_published_at_once_one_is_refused(service, results, monkeypatch):
    invented = reported(service, "others", [replace(result, truth_digest="0" * 64) for result in results])
    honest, shown, original = reported(service, "reef lab", results), threading.Event(), service._show
    found: list[object] = []

    def publish_other():
        try:
            found.append(service.publish("others", invented))
        except Refusal as refusal:
            found.append(refusal)

    def show(record):
        if not shown.is_set():
            shown.set()
            other.start()
            other.join(0.3)  # as long as it takes to be there first, without the lock
        original(record)

    other = threading.Thread(target=publish_other)
    monkeypatch.setattr(service, "_show", show)
    service.publish("reef lab", honest)
    other.join()
    assert isinstance(found[0], Refusal)
    assert DO in found[0].reason
    assert len(service.store.digests()) == 1


def test_nothing_is_published_without_the_lock_where_its_file_is_closed(store):
    (store.folder / ".publishing.lock").mkdir(parents=True)  # what even root cannot open for writing
    with pytest.raises(IsADirectoryError):
        publish(store, [(record_made("carp"), None)])
    assert store.digests() == []


def test_publications_take_one_thread_of_the_server(service, monkeypatch):
    inside, most, ended = [], [], threading.Event()

    def publish_one(team, id):
        inside.append(id)
        most.append(len(inside))
        ended.wait(0.02)
        inside.remove(id)
        return id

    async def all_of_them():
        auth = Auth(service)
        return await asyncio.gather(*(auth.publish("reef lab", str(k)) for k in range(9)))

    monkeypatch.setattr(service, "publish", publish_one)
    assert asyncio.run(all_of_them()) == [str(k) for k in range(9)]
    assert max(most) == 1
