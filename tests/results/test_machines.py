"""Speeds of several machines are told to be so, and each method has its date."""

from __future__ import annotations

import pytest

from oysterbench.report.html import html_report
from oysterbench.report.making import scored_when
from oysterbench.report.sequences import SlamRun
from oysterbench.report.tables import results_table
from oysterbench.results.comparison import boards
from oysterbench.results.machines import machines_note
from oysterbench.results.records import ResultRecord
from oysterbench.results.remarks import remarks

BIG, SMALL = {"cpu": "Big", "cores": 64}, {"cpu": "Small", "cores": 1}


def result(method: str, hardware, day: str = "2026-11-24", sequence: str = "a", **metrics: float) -> ResultRecord:
    return ResultRecord(
        track="slam",
        split="s",
        sequence=sequence,
        method=method,
        metrics={"score": 0.9, "realtime_factor": 2.0, "coverage": 1.0, **metrics},
        hardware=hardware,
        oysterbench_version="1.0.0",
        created=f"{day}T10:00:00Z",
    )


def test_speeds_of_several_machines_are_remarked_in_every_comparison():
    found = boards([result("fast", BIG), result("slow", SMALL)])
    note = "speeds are of different machines and do not compare methods: fast on Big, 64 cores; slow on Small, 1 core"
    assert note in remarks(found)
    assert note[1:] in html_report([SlamRun(result("fast", BIG)), SlamRun(result("slow", SMALL))], "x")


@pytest.mark.parametrize("hardware", [BIG, {}])
def test_one_machine_or_none_that_is_known_needs_no_remark(hardware):
    assert machines_note([result("fast", BIG), result("slow", hardware)]) == ""


def test_what_has_no_speed_is_no_matter():
    still = ResultRecord(track="slam", split="s", sequence="a", method="m", metrics={"score": 0.5}, hardware=SMALL)
    assert machines_note([result("fast", BIG), still]) == ""


@pytest.mark.parametrize(
    ("days", "told"),
    [
        (("24", "24", "24"), "one, two on 2 sequences, scored by oysterbench 1.0.0 on 2026-11-24."),
        (
            ("22", "24", "25"),
            "one (2026-11-22 to 2026-11-24), two (2026-11-25) on 2 sequences, scored by oysterbench 1.0.0.",
        ),
    ],
)
def test_each_method_of_a_report_has_its_own_date(days, told):
    names = (("one", "a"), ("one", "b"), ("two", "a"))
    records = [result(m, BIG, f"2026-11-{day}", s) for (m, s), day in zip(names, days, strict=True)]
    assert scored_when(records) == told
    assert told in html_report([SlamRun(record) for record in records], "x")


def test_no_speed_is_the_best_of_several_machines():
    def kinds(slow_on):
        rows = results_table([result("fast", BIG), result("slow", slow_on, realtime_factor=0.5)]).rows
        return {cell.kind for row in rows for cell in row.cells}

    assert kinds(BIG) == {"", "best"}
    assert kinds(SMALL) == {""}


def test_processor_time_on_images_is_not_compared_across_machines_either():
    def on_images(method, machine, cpu_s, **changes):
        metrics = {"iou": 0.5, "union_px": 10, "cpu_s": cpu_s, "images_per_s": 1 / cpu_s}
        values = {"track": "segmentation", "split": "s", "sequence": "a", "metrics": metrics, "hardware": machine}
        return ResultRecord(method=method, **{**values, **changes})

    records = [on_images("fast", BIG, 5.0), on_images("slow", SMALL, 50.0)]
    assert machines_note(records) != ""
    assert {cell.kind for row in results_table(records).rows for cell in row.cells} == {""}
    failed = on_images("slow", SMALL, 50.0, failure="no masks")
    assert failed.metrics["cpu_s"] == 50.0, "it was spent, though on nothing"
    assert machines_note([records[0], failed]) == ""


def test_what_a_failed_run_spent_is_shown_but_is_no_record():
    about = {"track": "segmentation", "split": "s", "sequence": "a", "hardware": BIG}
    good = {"iou": 0.8, "union_px": 10, "cpu_s": 30.0, "peak_memory_mb": 900.0}
    crashed = {"union_px": 10, "cpu_s": 0.4, "peak_memory_mb": 60.0}
    records = [
        ResultRecord(method="good", metrics=good, **about),
        ResultRecord(method="crash", metrics=crashed, failure="ImportError", **about),
    ]
    rows = results_table(records).rows
    assert [cell.value for cell in rows[1].cells if cell.value in (0.4, 60.0)] == [0.4, 60.0]
    assert [cell.value for row in rows for cell in row.cells if cell.kind == "best"] == [0.8]
    other = ResultRecord(method="slow", metrics={**good, "cpu_s": 40.0}, **about)
    best = [cell.value for row in results_table([*records, other]).rows for cell in row.cells if cell.kind == "best"]
    assert best == [0.8, 30.0, 0.8]


def test_what_some_of_the_runs_spent_in_failing_makes_a_method_no_better():
    about = {"track": "slam", "split": "s", "sequence": "a", "hardware": BIG}
    spent = {"score": 0.5, "coverage": 0.7, "cpu_s": 30.0, "peak_memory_mb": 900.0}
    flaky = {**spent, "score": 0.6, "coverage": 1.0, "peak_memory_mb": 910.0}
    records = [ResultRecord(method="whole", run=run, metrics=spent, **about) for run in range(3)]
    records += [ResultRecord(method="flaky", run=run, metrics=flaky, **about) for run in range(2)]
    crashed = {"cpu_s": 0.4, "peak_memory_mb": 60.0}
    records.append(ResultRecord(method="flaky", run=2, metrics=crashed, failure="ImportError", **about))
    cells = [
        {cell.value: cell.kind for cell in row.cells if hasattr(cell, "kind")} for row in results_table(records).rows
    ]
    shown = pytest.approx((910.0 * 2 + 60.0) / 3)
    assert [kind for value, kind in cells[1].items() if value == shown] == [""]
    assert cells[0][900.0] == "best"
