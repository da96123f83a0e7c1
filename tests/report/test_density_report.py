"""Results of the density track in tables and on the page."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from oysterbench.mapping import MapSettings
from oysterbench.mapping.grid import Total
from oysterbench.report import comparison_tables, csv_text, html_report, results_table
from oysterbench.report.density_figure import counted, drawn
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


@pytest.mark.parametrize(
    ("live", "dead", "unknown", "total", "states"),
    [(195.0, 58.5, 0.0, "254", "195 live, 59 dead"), (0.5, 0.5, 0.5, "2", "0 live, 1 dead, 1 live or dead unknown")],
)
def test_numbers_by_state_add_up_to_the_total(live, dead, unknown, total, states):
    told = counted(Total(live + dead + unknown, 1, 300, live, dead, unknown, 6.12, *(math.nan,) * 5))
    assert told.startswith(f"{total} oysters counted ")
    assert told.endswith(f": {states}")
