"""What may not be compared, or is of several kinds, is kept apart and named in one report."""

from __future__ import annotations

import html
import re
from dataclasses import replace

from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.evaluate.slam.settings import Align
from oysterbench.report import SlamRun, html_report
from oysterbench.report.columns import metric_column
from oysterbench.report.consistency import consistency_table
from oysterbench.report.sequences import sequence_plots
from oysterbench.tracks.track import shown_tables
from tests.report.test_report import loop, run
from tests.results.test_results import record


def aligned(method: str, align: Align) -> SlamRun:
    """A run whose method brings an alignment of its own."""
    made = run(method)
    settings = SlamSettings(align=align)
    return SlamRun(replace(made.record, settings=settings.as_dict()), score(loop(), loop(), settings))


def test_results_of_different_alignments_have_tables_of_their_own_in_the_terminal():
    made = record(method="vi"), record(method="mono", metrics={"score": 0.99}, settings={"align": "sim3"})
    tables = [table for table in shown_tables(made, runs=True) if table.rows]
    assert [[cell.value for row in table.rows for cell in row.cells[1:2]] for table in tables] == [["vi"], ["mono"]]
    assert "align = sim3" in tables[1].title
    assert not any(cell.kind == "best" for table in tables for row in table.rows for cell in row.cells)


def test_paths_of_different_alignments_are_named_with_theirs():
    def facts(*runs):
        return sequence_plots(runs, "mini-01", {"vi": 1, "slow": 2, "mono": 3}).facts

    vi, slow, mono = aligned("vi", "posyaw"), aligned("slow", "posyaw"), aligned("mono", "sim3")
    assert "aligned by posyaw." in facts(vi, slow)
    assert "aligned by posyaw (vi, slow), sim3 (mono)." in facts(vi, slow, mono)


def dives(method: str, name: str, **changes):
    metrics = {"score": 0.6, "coverage": 1.0, "ate_rmse_m": 0.1, "nees_position": 3.0}
    about = {"method": method, "metrics": metrics, **changes}
    return [record(**about, sequence=f"{name}{k}", conditions={"depth_m": k}) for k in range(1, 8)]


def page(records) -> str:
    return html_report([SlamRun(one) for one in records], "oysterbench compare")


LOST = "A sequence with a score below 0.25 is lost; errors are medians over the others."


def test_errors_are_said_to_be_medians_also_where_methods_share_no_sequence():
    apart, alike = page([*dives("a", "s"), *dives("b", "t")]), page([*dives("a", "s"), *dives("b", "s")])
    assert (apart.count("over 7"), apart.count(LOST)) == (2, 1)
    assert LOST in alike
    assert LOST not in page(dives("a", "s")[:1])


def test_one_method_with_two_settings_has_two_styles():
    better = {"score": 0.9, "coverage": 1.0}
    two = [one for k in (1, 2) for one in dives("b", "s", method_settings={"k": k}, metrics=better)]
    text = page([*dives("a", "s"), *two])
    drawn = set(re.findall(r'class="p(\d)" data-label="([^"]*)"', text))
    assert drawn == {("1", "a"), ("2", "b (k = 1)"), ("3", "b (k = 2)")}


def test_a_report_of_two_tracks_is_headed_and_defined_by_both():
    maps = dives("a", "s", track="density", metrics={"map_score": 0.5, "coverage": 0.8}, settings={})
    text = page([*dives("a", "s"), *maps])
    assert "<h1>SLAM and Oyster maps on slam-mini</h1>" in text
    for track in ("slam", "density"):
        assert html.escape(metric_column("coverage", track=track).about) in text.partition("What the numbers mean")[2]
    assert "Coverage, Oyster maps" in text
    assert ", SLAM" not in page(dives("a", "s"))


def test_several_runs_of_a_method_are_told_apart_by_their_numbers():
    runs = [one for k in range(3) for one in dives("a", "s", run=k)[:1]]
    table = consistency_table([*runs, *dives("b", "s")[:1]])
    assert table is not None
    assert [row.cells[1].value for row in table.rows] == ["a, run 1", "a, run 2", "a, run 3", "b"]
    assert "a, run 2 on s1: 3" in page(runs)
