"""The index: what it answers, that it can be made anew, and that nobody ever sees half of it."""

from __future__ import annotations

import math
import unicodedata
from dataclasses import replace

import pytest
from sqlalchemy import text

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.statistics import summarise
from oysterbench.hub.canonical import canonical, sha256
from oysterbench.results.records import mean_weights, samples
from oysterbench.results.standings import ScoreTable
from oysterbench_leaderboard.boards.board import BoardInfo, Query
from oysterbench_leaderboard.boards.database import open_engine
from oysterbench_leaderboard.boards.index import BoardIndex, open_index
from oysterbench_leaderboard.boards.memory import MemoryIndex
from oysterbench_leaderboard.boards.ranking import evaluator_order
from oysterbench_leaderboard.boards.tables import board_table
from oysterbench_leaderboard.storage.store import StatusChange
from tests.helpers.boards_opened import ALL, opened, pages
from tests.helpers.records_made import fill, record_made, records_made


def board_of(index: BoardIndex, track: str = "slam", split: str = "slam-val") -> BoardInfo:
    """The newest board of a split."""
    return next(board for board in index.boards(track) if board.split == split)


def state_of(index: BoardIndex, digest: str) -> str:
    return index.row(digest).state


def test_rows_hold_the_means_of_the_statistics_and_the_medians_of_errors(store):
    digests = fill(store)
    index = opened(store)
    for name in ("carp2", "unet"):
        record, row = store.record(digests[name]), index.row(digests[name])
        for key, value in row.metrics.items():
            of = summarise(samples(record.results, key), mean_weights(record.results, key))
            expected = of.median if key in TRACKS[record.track].errors else of.mean
            assert value == pytest.approx(expected, rel=1e-14), key
        board = board_of(index, record.track, record.split)
        expected = summarise(samples(record.results, board.metric), mean_weights(record.results, board.metric))
        assert row.score == expected.mean
        assert (row.low, row.high) == pytest.approx((expected.interval.low, expected.interval.high), rel=1e-11)
    assert index.row(digests["carp2"]).coverage == index.row(digests["carp2"]).metrics["coverage"]


def test_what_failed_or_is_lacking_counts_as_nothing_and_is_counted(store):
    digests = fill(store)
    index = opened(store)
    gap, eel = index.row(digests["gap"]), index.row(digests["eel"])
    assert (gap.failures, gap.sequences) == (1, 7)
    assert (eel.failures, eel.sequences) == (2, 8)
    values = [r.metrics["score"] for r in store.record(digests["gap"]).results]
    assert gap.score == pytest.approx(sum(values) / 8, rel=1e-12)
    assert gap.coverage is not None
    assert gap.coverage < 7 / 8


def test_a_rebuilt_index_equals_one_that_grew(store, tmp_path):
    records = list(records_made().values())
    index = opened(store)
    for record in records[::-1]:
        store.add(record)
        index.refresh()
    fill(store)
    index.refresh()
    grown, revision = pages(index), index.revision
    fresh = opened(store, "fresh.sqlite")
    assert pages(fresh) == grown
    assert fresh.revision == revision
    assert fresh.boards() == index.boards()
    index.rebuild()
    assert pages(index) == grown


def test_a_sequence_that_was_answered_without_a_value_is_in_no_mean_and_no_failure(store):
    """As AP where no oyster is to be found: the board, the record's page and the statistics say the same."""
    record = record_made()
    first, *others = record.results
    bare = replace(first, metrics={**first.metrics, "score": math.nan}, reasons={"score": "nothing is there"})
    digest = store.add(replace(record, results=(bare, *others)))
    index = opened(store)
    row = index.row(digest)
    expected = summarise(samples(store.record(digest).results, "score"), None)
    assert expected.sequences == len(others)
    assert (row.score, row.failures) == (expected.mean, 0)
    assert (row.low, row.high) == pytest.approx((expected.interval.low, expected.interval.high), rel=1e-11)
    store.add(record_made("other", skill=0.3, failed=(first.sequence,)))
    index.refresh()
    grown = pages(index)
    assert index.row(digest).score == row.score
    assert index.row(grown[0].rows[1].digest).failures == 1
    index.rebuild()
    assert pages(index) == grown


def test_what_one_record_more_does_not_change_is_not_ranked_again(store, monkeypatch):
    for k in range(5):
        store.add(record_made(f"method {k}", skill=0.3 + 0.1 * k))
    for name in ("one", "two"):
        store.add(record_made(name, skill=0.6, track="segmentation", split="seg-val"))
    lacking = store.add(record_made("lacking", skill=0.6, without=("val-08",)))
    index = opened(store)
    ranked: list[int] = []
    whole = ScoreTable.standings
    monkeypatch.setattr(
        ScoreTable, "standings", lambda table, better: (ranked.append(len(table.values)), whole(table, better))[1]
    )
    new = store.add(record_made("new", skill=0.55))
    index.refresh()
    store.add(record_made("three", skill=0.6, track="segmentation", split="seg-val"))
    index.refresh()
    assert ranked == [7, 3], "only the board that the new record is on"
    grown = pages(index)
    index.rebuild()
    assert pages(index) == grown
    assert None not in (index.row(new).low, index.row(lacking).low)
    for row in grown[0].rows:
        if row.digest != lacking:
            (store.folder / "records" / f"{row.digest}.json").unlink()
    index.refresh()
    assert len(board_of(index).sequences) == 7


def test_the_revision_changes_with_every_change_and_not_without(store):
    index = opened(store)
    seen = [index.revision]
    digest = store.add(record_made())
    index.refresh()
    seen.append(index.revision)
    store.change_status(digest, "withdrawn", "A mistake.")
    index.refresh()
    seen.append(index.revision)
    assert len(set(seen)) == 3
    index.refresh()
    index.rebuild()
    assert index.revision == seen[-1]


def test_the_later_record_of_a_method_team_and_board_is_the_current_one(store):
    first = store.add(record_made(created="2026-01-01T00:00:00Z"))
    second = store.add(record_made(skill=0.5, created="2026-02-01T00:00:00Z"))
    other = store.add(record_made(team="another", created="2026-01-01T00:00:00Z"))
    index = opened(store)
    assert [state_of(index, d) for d in (first, second, other)] == ["superseded", "current", "current"]
    assert index.row(first).place is None
    assert [row.digest for row in index.method("carp", "reef lab")] == [second, first]


def test_names_in_another_unicode_form_are_the_same_and_the_records_keep_their_bytes(store):
    """As typed on macOS, where an accent is a character of its own."""
    apart = {"method": "c\u0327arp", "team": "Te\u0301am"}
    together = {key: unicodedata.normalize("NFC", name) for key, name in apart.items()}
    first = store.add(record_made(**apart, created="2026-01-01T00:00:00Z"))
    second = store.add(record_made(**together, skill=0.5, created="2026-02-01T00:00:00Z"))
    third = store.add(record_made(**apart, skill=0.6, created="2026-03-01T00:00:00Z"))
    assert {digest for digest, _ in store.records_by(together["team"], together["method"])} == {first, second, third}
    for index in (opened(store), MemoryIndex(store)):
        assert [state_of(index, digest) for digest in (first, second, third)] == ["superseded", "superseded", "current"]
        for names in (apart, together):
            assert [row.digest for row in index.method(**names)] == [third, second, first]
            assert index.page(board_of(index).id, Query(text=names["team"])).total == 1
    assert store.record(first).team == apart["team"]


def test_a_record_is_superseded_by_one_of_its_team_alone_on_whatever_board(store):
    old = record_made(evaluator="slam 2", created="2026-01-01T00:00:00Z")
    digest = store.add(old)
    index = opened(store)
    store.add(record_made("thief", "another", supersedes=digest, created="2026-02-01T00:00:00Z"))
    index.refresh()
    assert state_of(index, digest) == "current"
    again = store.add(record_made(supersedes=digest, created="2026-03-01T00:00:00Z"))
    index.refresh()
    assert state_of(index, digest) == "superseded"
    store.add_status_change(StatusChange(again, "withdrawn", "The evaluator was wrong.", "2026-04-01T00:00:00Z"))
    index.refresh()
    assert [state_of(index, d) for d in (digest, again)] == ["current", "withdrawn"]
    store.add_status_change(StatusChange(again, "restored", "It was right.", "2026-05-01T00:00:00Z"))
    index.refresh()
    assert [state_of(index, d) for d in (digest, again)] == ["superseded", "current"]


def test_two_notices_of_one_second_keep_their_order(store):
    digest = store.add(record_made())
    for action in ("withdrawn", "restored", "withdrawn", "restored"):
        store.change_status(digest, action, "To and fro.")
    assert state_of(opened(store), digest) == "current"


def test_damaged_records_are_named_and_left_out_and_the_rest_goes_on(store):
    digests = fill(store)
    folder = store.folder / "records"
    path = folder / f"{digests['cod']}.json"
    path.write_bytes(path.read_bytes().replace(b"harbour group", b"harbor  group"))
    worded = record_made().to_dict()
    worded["results"][0]["metrics"]["score"] = "0.5"
    made = {
        "not JSON": b"{",
        "not a record": canonical({"format": "something"}),
        "a list": canonical([1, 2]),
        "of an unknown track": record_made().data.replace(b'"track":"slam"', b'"track":"golf"'),
        "text for a number": canonical(worded),
        "a number for a result": canonical({**record_made().to_dict(), "results": [7]}),
        "settings of a wrong kind": canonical({**record_made().to_dict(), "results": "none"}),
        "several boards": canonical(
            {
                **record_made().to_dict(),
                "results": [
                    record_made().results[0].to_dict(),
                    record_made(evaluator="slam 1").results[1].to_dict(),
                ],
            }
        ),
    }
    wrong = {}
    for name, data in made.items():
        wrong[sha256(data)] = name
        (folder / f"{sha256(data)}.json").write_bytes(data)
    (folder / "notes.txt").write_text("not a record, and not in the way")
    index = opened(store)
    assert set(index.problems()) == {digests["cod"], *wrong}
    assert all(index.problems().values())
    assert [row.method for row in index.page(board_of(index).id, Query()).rows][:2] == [
        "carp",
        "gap",
    ]
    with pytest.raises(ResultError, match="it was changed"):
        index.row(digests["cod"])
    path.unlink()
    store.add(records_made()["cod"])
    index.rebuild()
    assert set(index.problems()) == set(wrong)
    assert state_of(index, digests["cod"]) == "current"


def test_damaged_notices_are_named_and_left_out(store):
    digests = fill(store)
    (store.folder / "changes" / f"{'0' * 64}.json").write_bytes(b"{}")
    index = opened(store)
    assert set(index.problems()) == {"0" * 64}
    assert state_of(index, digests["fraud"]) == "withdrawn"


def test_a_record_that_is_taken_away_leaves_the_board(store):
    digests = fill(store)
    index = opened(store)
    (store.folder / "records" / f"{digests['carp2']}.json").unlink()
    index.refresh()
    assert state_of(index, digests["carp1"]) == "current"
    assert pages(index) == pages(opened(store, "fresh.sqlite"))


def test_pages_sort_search_and_choose(store):
    digests = fill(store)
    index = opened(store)
    board = board_of(index).id

    def methods(**query: object) -> list[str]:
        return [row.method for row in index.page(board, Query(**query)).rows]  # type: ignore[arg-type]

    by_rank = methods()
    assert by_rank[0] == "carp"
    assert methods(descending=True) == by_rank[::-1]
    assert methods(sort="created")[0] == "drift"
    by_drift = index.page(board, Query(sort="ate_percent")).rows
    values = [row.metrics["ate_percent"] for row in by_drift]
    assert values == sorted(values, key=lambda v: v or 0)
    assert methods(text="HARBOUR") == [m for m in by_rank if m in ("cod", "gap", "eel")]
    assert methods(text="100 %") == ["\\input{/etc/passwd}"]
    assert methods(text="%") == [m for m in by_rank if m.startswith("\\")]
    assert methods(tiers=("baseline",)) == ["carp", "drift"]
    assert methods(states=("withdrawn",)) == ["fraud"]
    assert methods(size=3) + methods(size=3, page=2) + methods(size=3, page=3) == by_rank
    page = index.page(board, Query(size=3, page=9))
    assert (page.rows, page.total, page.pages) == ((), len(by_rank), 3)
    with pytest.raises(ResultError, match="sort: expected one of rank"):
        methods(sort="summary")
    assert index.row(digests["cod"][:8]).digest == digests["cod"]
    for odd in ("abc", "x" * 64, "0" * 64, "../../etc/passwd"):
        with pytest.raises(ResultError):
            index.row(odd)


def test_what_is_self_reported_is_shown_and_not_ranked(store):
    records = {name: record for name, record in records_made().items() if name in ("carp1", "cod", "drift")}
    fill(store, records)
    index = opened(store)
    before = [(row.method, row.place, row.rank, row.low) for row in index.page(board_of(index).id, Query()).rows]
    # The best of all, and on fewer sequences.
    store.add(record_made("boast", "somebody", 0.99, tier="reported", without=("val-08",)))
    index = opened(store, "with.sqlite")
    rows = index.page(board_of(index).id, Query()).rows
    assert [(row.method, row.place, row.rank, row.low) for row in rows[:-1]] == before
    boast = rows[-1]
    assert (boast.method, boast.state, boast.place, boast.rank, boast.tied) == ("boast", "current", None, None, False)
    assert boast.score == pytest.approx(0.99 * 7 / 8, abs=0.02)
    assert any("is not ranked" in note for note in board_table(index.page(board_of(index).id, Query())).notes)


def test_the_newest_evaluator_has_the_board(store):
    fill(store)
    index = opened(store)
    boards = index.boards("slam")
    assert [(board.evaluator_version, board.newest) for board in boards] == [("slam 3", True), ("slam 2", False)]
    assert board_of(index).evaluator_version == "slam 3"


def test_sequence_means_are_those_of_the_runs(store):
    digests = fill(store)
    means = opened(store).sequence_means(digests["carp2"][:12])
    found = samples(store.record(digests["carp2"]).results, "score")
    assert {name: of["score"] for name, of in means.items()} == pytest.approx(
        {name: sum(values) / len(values) for name, values in found.items()}
    )


def test_an_index_in_a_wrong_place_is_refused_in_one_line_without_its_password(store):
    with pytest.raises(ResultError, match="expected SQLite or PostgreSQL"):
        BoardIndex("mysql+pymysql://user@host/name", store)
    pytest.importorskip("psycopg")
    index = BoardIndex("postgresql://user:secret@127.0.0.1:1/name", store)
    with pytest.raises(ResultError) as caught:
        index.boards()
    assert "\n" not in str(caught.value)
    assert "secret" not in str(caught.value)


def test_a_database_without_an_encoding_is_one_like_others(store, postgres):
    engine = open_engine(postgres, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        plain = "CREATE DATABASE plain ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0"
        connection.execute(text(plain))
    engine.dispose()
    index = open_index(store, postgres.replace("/postgres?", "/plain?"))
    assert pages(index) == pages(opened(store))
    index.close()


def test_postgresql_gives_the_same_answers(store, postgres, request):
    records = records_made()
    half = dict(list(records.items())[:5])
    for record in half.values():
        store.add(record)
    index = open_index(store, postgres)
    request.addfinalizer(index.close)
    before, revision = pages(index), index.revision
    assert before == pages(opened(store))
    fill(store)
    index.refresh()
    assert pages(index) == pages(opened(store))
    assert index.revision != revision
    index.rebuild()
    fresh = opened(store)
    assert pages(index) == pages(fresh)
    assert index.methods() == fresh.methods()
    assert pages(index, replace(ALL, sort="method")) == pages(fresh, replace(ALL, sort="method"))
    assert pages(index, replace(ALL, sort="coverage", descending=True, text="%")) == pages(
        fresh, replace(ALL, sort="coverage", descending=True, text="%")
    )
    assert index.method("ca\0rp") == fresh.method("ca\0rp") == []
    nothing = [index.page(info.id, replace(ALL, text="\0")).rows for info in index.boards()]
    assert nothing == [()] * len(nothing)


def test_any_text_has_a_place_in_the_order_of_evaluators():
    versions = ["slam ²", "slam 1" + "0" * 5000, "slam 10", "slam 3", "slam"]
    assert sorted(versions, key=evaluator_order) == versions[::-1]
