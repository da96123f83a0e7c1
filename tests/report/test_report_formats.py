"""Every form of the tables says the same numbers: CSV to the last digit, LaTeX and Markdown as they are shown."""

from __future__ import annotations

import csv
import io
import math
import re

import pytest

from oysterbench.report import csv_text, latex_text, markdown_text, results_table, tables
from tests.helpers import latex
from tests.results.test_comparison import BAD, GOOD, runs
from tests.results.test_results import failed, record

AWKWARD = r"a_b & 50% #1 {x} ~ ^ \cmd $y$ | *b* <i> [c]"


def some_records():
    third = record(metrics={"score": 1 / 3, "ate_rmse_m": 0.1 + 0.2, "coverage": 0.9}, method=AWKWARD, seed=7)
    nan = record(metrics={"score": 0.25, "scale": math.nan}, reasons={"scale": "none"}, conditions={"secchi_m": 2.5})
    return [third, nan, failed(method="lost", sequence="mini-02")]


EVERYTHING = [
    *runs("good", GOOD, ("clear", "turbid"), conditions={"water": "clear"}),
    *runs("bad", BAD, method_settings={"k": 1}),
    *runs(AWKWARD, [*GOOD[:7], None]),
]


def test_csv_gives_back_every_run_to_the_last_digit():
    records = some_records()
    read = list(csv.DictReader(io.StringIO(csv_text(records))))
    assert len(read) == 3
    for line, kept in zip(read, records, strict=True):
        assert (line["method"], line["sequence"], line["failure"]) == (kept.method, kept.sequence, kept.failure or "")
        assert (line["seed"], line["run"]) == ("" if kept.seed is None else str(kept.seed), str(kept.run))
        for key, value in kept.metrics.items():
            assert line[key] == "" if math.isnan(value) else float(line[key]) == value
    assert read[0]["condition.secchi_m"] == ""
    assert float(read[1]["condition.secchi_m"]) == 2.5
    assert read[2]["ate_rmse_m"] == ""  # a failed run has no error, and not an error of zero


def cells_of_markdown(text: str) -> list[list[str]]:
    found = []
    for line in text.splitlines():
        if line.startswith("| "):
            parts = re.split(r"(?<!\\) ?\| ?", line)[1:-1]
            parts = [match[1] if (match := re.fullmatch(r"\*\*(.*)\*\*", part)) else part for part in parts]
            found.append([re.sub(r"\\([\\`*_\[\]<>|#])", r"\1", part) for part in parts])
    return found


@pytest.mark.parametrize("records", [some_records(), EVERYTHING], ids=["few", "many"])
def test_latex_and_markdown_hold_every_cell_as_it_is_shown(records):
    markdown = cells_of_markdown(markdown_text(records))
    on_paper = [row for table in latex.read(latex_text(records)) for row in table.rows]
    made = tables(records)
    assert sum(len(table.rows) for table in made) >= 3
    for table in made:
        for row, texts in zip(table.rows, table.texts, strict=True):
            marks = [f" ({cell.mark})" if cell.mark else "" for cell in row.cells]
            cells = [text + mark for text, mark in zip(texts, marks, strict=True)]
            assert cells in markdown
            assert [cell.replace("−", "$-$") for cell in cells] in on_paper


def test_a_shown_number_is_the_kept_one_rounded():
    (line,) = cells_of_markdown(markdown_text([record(metrics={"score": 0.12345, "ate_rmse_m": 1.23456})]))[2:]
    assert [float(line[2]), float(line[3])] == [0.123, 1.235]


def test_no_runs_are_a_head_without_lines():
    assert csv_text([]).count("\n") == 1
    assert len(cells_of_markdown(markdown_text([]))) == 2
    assert r"\bottomrule" in latex_text([])


def test_several_runs_are_one_line_with_their_mean():
    records = [record(metrics={"score": s, "coverage": 1.0}, run=k) for k, s in enumerate((0.1, 0.9, 0.7))]
    (texts,) = results_table([*records, failed(run=3)]).texts
    assert texts[1:3] == ("dead_reckoning (4 runs, 1 failed)", "0.425")
    found = next(table for table in tables(records) if table.title.startswith("Runs"))
    assert found.texts[0][2:6] == ("3", "0", "0.700", "0.100 to 0.900")


def test_standings_show_coverage_and_failures_beside_the_errors():
    standings = next(table for table in tables(EVERYTHING) if table.title.startswith("Standings"))
    headings = [column.heading for column in standings.columns]
    assert {"Coverage", "ATE", "Lost", "95%"} <= set(headings)
    shown = {texts[1]: dict(zip(headings, texts, strict=True)) for texts in standings.texts}
    assert shown["good"]["Rank"].startswith("1")
    assert shown["bad"]["Rank"] == "3"
    assert (shown[AWKWARD]["Lost"], shown["good"]["Lost"]) == ("1", "0")
    assert re.fullmatch(r"0\.\d{3} to 0\.\d{3}", shown["good"]["95%"])


def test_what_may_not_be_compared_stands_in_tables_of_its_own():
    records = [*runs("a", [0.9, 0.8]), *runs("a", [0.1, 0.2], settings={"align": "se3"})]
    found = [table for table in tables(records) if table.title.startswith("Results")]
    assert [table.title for table in found] == [
        "Results on slam-mini (align = posyaw)",
        "Results on slam-mini (align = se3)",
    ]
    assert [table.texts[0][2] for table in found] == ["0.900", "0.100"]


def test_pairs_that_are_too_few_to_tell_are_no_rows():
    found = tables([*runs("a", [0.9, 0.8]), *runs("b", [0.8, 0.6]), *runs("c", [0.1, 0.2])])
    assert [table.title.split()[0] for table in found] == ["Results", "Standings"]
    assert any("too few sequences for ranks" in note for note in found[1].notes)


def test_the_one_pair_that_was_asked_for_is_shown_however_few_its_sequences():
    found = next(table for table in tables([*runs("a", [0.9]), *runs("b", [0.8])]) if table.title.startswith("Pairs"))
    assert [texts[-1] for texts in found.texts] == ["too few to tell"]
