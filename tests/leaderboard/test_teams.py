"""A team that publishes many methods pushes nobody down: ahead of others counts its best alone."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.results.standings import REFERENCES, ScoreTable, SequenceScores
from oysterbench_leaderboard.boards.board import BoardInfo
from oysterbench_leaderboard.boards.ranking import Ranked, rank
from oysterbench_leaderboard.boards.teams import standings_by_team
from oysterbench_leaderboard.storage.record_summary import RecordSummary
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from tests.helpers.serving import done

NAMES = tuple(f"dive-{k:02d}" for k in range(10))
BOARD = BoardInfo("0" * 16, "slam", "slam-test", "d", "slam 1", {}, "score", (), (), 0, "", True)


def ranked(name: str, base: float, team: str = "", tier: str = "scored") -> Ranked:
    """A record whose scores lie around `base`, by its name."""
    noise = np.random.default_rng(list(name.encode())).uniform(0, 0.02, len(NAMES))
    values = {name: base + 0.02 * k + float(noise[k]) for k, name in enumerate(NAMES)}
    summary = RecordSummary(SequenceScores(values), dict.fromkeys(NAMES, 1.0), NAMES, 0)
    return Ranked(name, "current", team or name, tier, "2026-11-01T00:00:00Z", summary)


def ranks(found: list[Ranked]) -> dict[str, int | None]:
    return {row["key"]: row["rank"] for row in rank(BOARD, found)[1]}


OTHERS = [ranked("second", 0.5), ranked("third", 0.4)]


@pytest.mark.parametrize("count", [9, REFERENCES + 10])
def test_one_result_under_many_names_pushes_nobody_down(count):
    many = [ranked(f"clone {k}", 0.6, "winner") for k in range(count)]
    found = ranks([ranked("winner", 0.61, "winner"), *many, *OTHERS])
    assert (found["winner"], found["second"], found["third"]) == (1, 2, 3)


def test_a_teams_further_methods_are_ranked_behind_its_own_better_ones():
    own = [ranked(f"own {k}", base, "reef lab") for k, base in enumerate((0.7, 0.6, 0.45))]
    assert ranks([*own, *OTHERS]) == {"own 0": 1, "own 1": 2, "second": 2, "own 2": 4, "third": 3}


def test_every_baseline_counts_as_they_are_of_many_authors():
    ours = [ranked(f"baseline {k}", 0.6 + 0.1 * k, "oysterbench", "baseline") for k in range(3)]
    found = ranks([*ours, *OTHERS])
    assert found == {"baseline 2": 1, "baseline 1": 2, "baseline 0": 3, "second": 4, "third": 5}


@pytest.mark.parametrize("weighed", [False, True])
def test_one_team_alone_and_teams_of_one_method_are_ranked_as_in_a_comparison(weighed):
    draw, count = np.random.default_rng(5), 12 if weighed else 60
    values = np.clip(0.5 + draw.normal(0, 0.1, (count, 1)) + draw.normal(0, 0.1, (count, 8)), 0, 1)
    values[3, :4] = np.nan
    values[7] = values[8]
    table = ScoreTable(values, draw.uniform(1, 2, values.shape) if weighed else None)
    table.values[-1] = 0
    expected = [(one.place, one.rank) for one in table.standings("higher")]
    for teams in (["one"] * count, list(range(count)), ["one"] * (count - 1) + ["another, far behind"]):
        found = standings_by_team(table, teams, "higher")
        assert [(one.place, one.rank) for one in found[:-1]] == expected[:-1]
    assert standings_by_team(table.take([]), [], "higher") == []
    without = ScoreTable(np.full((3, 8), np.nan))
    assert [one.place for one in standings_by_team(without, [1, 1, 2], "higher")] == [None] * 3


def test_no_further_method_ranks_before_a_best_one_placed_above_it():
    draw = np.random.default_rng(6)
    for better, sign in (("higher", 1), ("lower", -1)):
        values = sign * (draw.normal(0, 0.1, (60, 1)) + draw.normal(0, 0.1, (60, 8)))
        table, teams = ScoreTable(values), draw.integers(0, 12, 60).tolist()
        found = standings_by_team(table, teams, better)
        best = {}
        for row in sorted(range(60), key=lambda row: found[row].place):
            assert found[row].rank <= found[row].place
            assert found[row].rank >= max([found[one].rank for one in best.values()], default=1)
            best.setdefault(teams[row], row)


def test_the_same_files_are_published_under_one_name(service, tmp_path):
    carp, eel = done(service, tmp_path), done(service, tmp_path, method="eel")
    first = service.publish("reef lab", carp).published
    with pytest.raises(Refusal, match=f"as your method carp: .*withdraw submission {carp} first") as raised:
        service.publish("reef lab", eel)
    assert raised.value.status == 409
    assert service.store.digests() == [first]
    others = service.publish("others", done(service, tmp_path, team="others", method="eel")).published
    service.withdraw("reef lab", carp)
    assert service.publish("reef lab", eel).published in service.store.digests()
    assert others in service.store.digests()
