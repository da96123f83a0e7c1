"""Results of the density track in tables and on the page."""

from __future__ import annotations

from dataclasses import replace

from oysterbench.mapping import MapSettings
from oysterbench.report import comparison_tables, csv_text, html_report, results_table
from oysterbench.report.density_figure import drawn
from oysterbench.tracks.mapping_evaluation import TRUE_POSES, MappedSequence, evaluate_maps
from tests.helpers.flat_reef import LANE, FlatReef, scattered


def test_paths_stand_beside_each_other_in_table_and_page():
    reef = FlatReef(LANE[:4], scattered(-0.6, 1.8))
    late = replace(reef.truth(), stamps_ns=reef.stamps + 10**12)
    runs = list(evaluate_maps(MappedSequence(reef, "cam", {"late": late}), None, MapSettings(cell_m=0.5)))
    runs = [drawn(run) for run in runs]
    records = [run.record for run in runs]
    table = results_table(records)
    assert [texts[1] for texts in table.texts] == [TRUE_POSES, "late"]
    assert table.rows[1].kind == "failed"
    assert isinstance(comparison_tables(records), list)
    assert csv_text(records).count("\n") == 3
    page = html_report(runs, "oysterbench eval --track density")
    assert page.count("<svg xmlns") == 2
    assert page.count("oysters counted (95 %:") == 2
    assert "Oyster maps on flat" in page
