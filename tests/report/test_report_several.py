"""What may not be compared, or is of several kinds, is kept apart and named in one report."""

from __future__ import annotations

from dataclasses import replace

from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.report import SlamRun
from oysterbench.report.sequences import sequence_plots
from oysterbench.tracks.track import shown_tables
from tests.report.test_report import loop, run
from tests.results.test_results import record


def aligned(method: str, align: str) -> SlamRun:
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
