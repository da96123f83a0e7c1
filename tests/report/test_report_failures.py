"""A report of runs that failed says where their output is, and promises no paths."""

from __future__ import annotations

from dataclasses import replace

import pytest

from oysterbench.report import results_table
from oysterbench.report.columns import metric_column
from oysterbench.report.html import html_report, write_html_report
from oysterbench.report.sequences import SlamRun
from oysterbench.results.records import output_place
from tests.report.test_report import failed, run
from tests.results.test_results import record

ELSEWHERE = "Paths are drawn in the report of each evaluation."


def test_paths_are_promised_only_of_trajectories_that_there_are():
    kept = replace(run("a"), result=None, frames=[])
    assert ELSEWHERE in html_report([kept], "x")
    assert ELSEWHERE not in html_report([failed("a")], "x")
    masks = SlamRun(replace(kept.record, track="segmentation", metrics={"iou": 0.5, "union_px": 9.0}))
    assert ELSEWHERE not in html_report([masks], "x")


def test_a_failed_run_is_told_with_the_place_of_its_output(tmp_path):
    one = failed("mine")
    write_html_report(tmp_path / "report.html", [one], "x")
    assert "full output" not in (tmp_path / "report.html").read_text()
    (tmp_path / output_place(one.record)).mkdir(parents=True)
    write_html_report(tmp_path / "report.html", [one], "x")
    assert "full output of mine on mini-01: runs/mine/mini-01/1" in (tmp_path / "report.html").read_text()


def test_a_share_in_percent_is_not_defined_from_0_to_1():
    assert metric_column("coverage").about.startswith("Share of all ground-truth poses")
    assert "(0 to 1)" in metric_column("score").about


@pytest.mark.parametrize(
    ("track", "metric", "failed_as"),
    [("slam", "score", "scores 0"), ("steering", "skill", "scores as the worst command at each image")],
)
def test_a_failed_run_of_several_is_told_to_count_as_its_track_counts_it(track, metric, failed_as):
    records = [record(track=track, metrics={metric: 0.5}, run=k) for k in range(2)]
    note = f"Of several runs, means are shown; a failed one {failed_as}, and has no errors."
    assert note in results_table(records).notes
    assert note in html_report([SlamRun(one) for one in records], "x")
    assert not any("several" in text for text in results_table(records[:1]).notes)
