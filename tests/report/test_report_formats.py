"""Every form of the tables says the same numbers: CSV to the last digit, LaTeX and Markdown as they are shown."""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
import subprocess

import pytest

from oysterbench.report import csv_text, latex_text, markdown_text, tables
from oysterbench.report.formats import latex_escape
from oysterbench.report.tables import rows
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


def unescaped_latex(text: str) -> str:
    for shown, written in {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        "−": "$-$",
        "–": "--",
    }.items():
        text = text.replace(written, f"\0{ord(shown)}\0")
    text = re.sub(r"^\{(.*)\}$", r"\1", text)
    text = re.sub(r"\\([&%$#_{}])", r"\1", text)
    return re.sub("\0(\\d+)\0", lambda match: chr(int(match[1])), text)


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


def cells_of_latex(text: str) -> list[list[str]]:
    found = []
    for line in text.splitlines():
        if line.endswith(r"\\"):
            parts = re.split(r"(?<!\\) & ", line[: -len(r" \\")])
            parts = [match[1] if (match := re.fullmatch(r"\\textbf\{(.*)\}", part)) else part for part in parts]
            found.append([unescaped_latex(part) for part in parts])
    return found


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
    latex, markdown = cells_of_latex(latex_text(records)), cells_of_markdown(markdown_text(records))
    expected = [list(line.cells) for table in tables(records) for line in table.lines]
    assert len(expected) >= 3
    for cells in expected:
        assert cells in markdown
        assert cells in latex


def test_a_shown_number_is_the_kept_one_rounded():
    (line,) = cells_of_markdown(markdown_text([record(metrics={"score": 0.12345, "ate_rmse_m": 1.23456})]))[2:]
    assert [float(line[2]), float(line[3])] == [0.123, 1.235]


def test_latex_is_balanced_and_uses_booktabs():
    text = latex_text(EVERYTHING)
    for rule in (r"\toprule", r"\midrule", r"\bottomrule"):
        assert text.count(rule) >= text.count(r"\begin{tabular}") >= 3
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}")
    assert "usepackage{booktabs,graphicx}" in text
    columns = re.findall(r"\\begin\{tabular\}\{([lr]+)\}", text)
    assert {len(spec) for spec in columns} >= {len(tables(EVERYTHING)[0].headings)}


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_latex_compiles(tmp_path):
    body = latex_text(EVERYTHING)
    source = rf"\documentclass{{article}}\usepackage{{booktabs,graphicx}}\begin{{document}}{body}\end{{document}}"
    (tmp_path / "t.tex").write_text(source)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.parametrize("text", ["\\", "&%$#_{}", "~^", "<>|", "[2cm]", "–", "a\nb"])
def test_nothing_in_latex_is_a_command(text):
    assert not re.search(r"(?<!\\)[&%#_]", latex_escape(text))
    assert "\n" not in latex_escape(text)
    assert not latex_escape(text).startswith("[")


def test_no_runs_are_a_head_without_lines():
    assert csv_text([]).count("\n") == 1
    assert len(cells_of_markdown(markdown_text([]))) == 2
    assert r"\bottomrule" in latex_text([])


def test_several_runs_are_one_line_with_their_median():
    records = [record(metrics={"score": s, "coverage": 1.0}, run=k) for k, s in enumerate((0.1, 0.9, 0.8))]
    (row,) = rows([*records, failed(run=3)])
    assert (row.method, row.cells[0]) == ("dead_reckoning (4 runs, 1 failed)", "0.450")
    found = next(table for table in tables(records) if table.title.startswith("Runs"))
    assert found.lines[0].cells[2:6] == ("3", "0", "0.800", "0.100 to 0.900")


def test_standings_show_coverage_and_failures_beside_the_errors():
    standings = next(table for table in tables(EVERYTHING) if table.title.startswith("Standings"))
    headings = [heading.text for heading in standings.headings]
    assert {"cover", "ATE", "failed", "95%"} <= set(headings)
    shown = {line.cells[1]: dict(zip(headings, line.cells, strict=True)) for line in standings.lines}
    assert shown["good"]["rank"].startswith("1")
    assert shown["bad"]["rank"] == "3"
    assert shown[AWKWARD]["failed"] == "1 of 8"
    assert re.fullmatch(r"0\.\d{3} to 0\.\d{3}", shown["good"]["95%"])


def test_what_may_not_be_compared_stands_in_tables_of_its_own():
    records = [*runs("a", [0.9, 0.8]), *runs("a", [0.1, 0.2], settings={"align": "se3"})]
    found = [table for table in tables(records) if table.title.startswith("Results")]
    assert [table.title for table in found] == [
        "Results on slam-mini (align = posyaw)",
        "Results on slam-mini (align = se3)",
    ]
    assert [table.lines[0].cells[2] for table in found] == ["0.900", "0.100"]
