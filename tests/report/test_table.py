"""One model of a table, and its renderers: the same numbers in every form."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest
from rich.console import Console

from oysterbench.evaluate.statistics import Interval
from oysterbench.report.renderers import (
    csv_table,
    html_table,
    json_table,
    latex_escape,
    latex_tables,
    markdown_table,
    terminal_table,
)
from oysterbench.report.table import Bar, Cell, Column, Estimate, Table, TableRow, interval_column
from tests.helpers import latex

NASTY = r"a_b & 50% #1 {x} ~ ^ \cmd $y$ | *b* <i> [c]"
SCORE = Column("score", "Score", kind="number", digits=3, better="higher", about="Area under recall.")
ATE = Column("ate_rmse_m", "ATE", "m", "estimate", digits=2, small=0.1, better="lower")
TABLE = Table(
    "Results of 100 %",
    (
        Column("method", "Method"),
        SCORE,
        interval_column(SCORE),
        ATE,
        Column("coverage", "Coverage", "%", "number", short="cover", digits=1, factor=100.0, cut=True),
        Column("digest", hidden=True),
    ),
    (
        TableRow((NASTY, Cell(1 / 3, kind="best"), Interval(0.25, 0.5), 0.5, 0.9999, "f00")),
        TableRow(("=1+1", -0.25, Interval(math.nan, math.nan, "one sequence"), None, 0.5, Cell(2, "two"))),
        TableRow((Cell("mean", mark="of 2"), 0.0, None, Estimate(2.0, Interval(1.0, 3.0)), math.nan, ""), "mean"),
    ),
    ("Read & weep: 100 %.",),
    "results",
)


def test_numbers_of_a_column_are_shown_with_the_same_decimals():
    assert [row[1] for row in TABLE.texts] == ["0.333", "−0.250", "0.000"]
    assert ATE.texts([0.25, 12.5]) == ["0.25", "12.50"]
    assert ATE.texts([0.25, 0.042]) == ["0.250", "0.042"]


def test_no_number_is_a_hundred_digits_wide():
    assert ATE.texts([999_999_999.0, 1e9, -1.234e99]) == ["999999999", "1e+09", "−1.23e+99"]
    assert ATE.text(Interval(-1e99, 2.0)) == "−1e+99 to 2.00"
    assert Column("share", digits=1, factor=100.0, cut=True, signed=True).text(1e99) == "+1e+101"
    assert Column("poses", kind="number").text(12_345_678_901) == "12345678901"


def test_what_is_cut_is_never_rounded_up():
    assert [row[4] for row in TABLE.texts] == ["99.9", "50.0", "–"]


def test_intervals_are_shown_by_both_ends_or_by_a_dash():
    assert [row[2] for row in TABLE.texts] == ["0.250 to 0.500", "–", "–"]
    assert [row[3] for row in TABLE.texts] == ["0.50", "–", "2.00 [1.00 to 3.00]"]


def test_a_signed_number_has_a_sign():
    signed = Column("difference", kind="interval", digits=1, signed=True)
    assert signed.texts([1.0, -1.0, Interval(-0.5, 0.5)]) == ["+1.0", "−1.0", "−0.5 to +0.5"]


def test_csv_has_every_digit_and_nothing_that_a_spreadsheet_would_run():
    read = list(csv.DictReader(io.StringIO(csv_table(TABLE))))
    assert list(read[0]) == [
        "method",
        "score",
        "score_interval_low",
        "score_interval_high",
        *("ate_rmse_m", "ate_rmse_m_low", "ate_rmse_m_high", "coverage", "digest"),
    ]
    assert [line["method"] for line in read] == [NASTY, "'=1+1", "mean"]
    assert float(read[0]["score"]) == 1 / 3
    assert [line["score_interval_low"] for line in read] == ["0.25", "", ""]
    assert [line["ate_rmse_m"] for line in read] == ["0.5", "", "2.0"]
    assert [line["digest"] for line in read] == ["f00", "2", ""]
    assert read[2]["coverage"] == ""


def test_json_has_every_digit_and_null_for_what_is_absent():
    read = json.loads(json.dumps(json_table(TABLE), allow_nan=False))
    assert [row["score"] for row in read["rows"]] == [1 / 3, -0.25, 0.0]
    assert read["rows"][0]["score_interval"] == {"low": 0.25, "high": 0.5}
    assert read["rows"][2]["ate_rmse_m"] == {"value": 2.0, "low": 1.0, "high": 3.0}
    assert read["rows"][2]["coverage"] is None
    assert read["columns"][1]["better"] == "higher"


def test_markdown_holds_every_shown_cell():
    text = markdown_table(TABLE)
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert rows[1] == "| :--- | ---: | ---: | ---: | ---: |"
    assert "**0.333**" in rows[2]
    assert "Coverage \\[%\\]" in rows[0]
    assert r"50% \#1 {x}" in rows[2]
    assert "mean (of 2)" in rows[4]
    assert "Read & weep" in text


def test_latex_is_read_back_as_it_is_shown():
    (read,) = latex.read(latex_tables([TABLE], "of a test"))
    assert read.columns == "lrrrr"
    assert read.caption == TABLE.title
    assert read.rows[0] == ["Method", "Score", "95%", "ATE", "Coverage"]
    assert read.rows[2][:3] == [NASTY, "0.333", "0.250 to 0.500"]
    assert read.rows[4][0] == "mean (of 2)"
    assert r"\textbf{0.333}" in latex_tables([TABLE])
    assert r"\label{tab:results}" in latex_tables([TABLE])


@pytest.mark.parametrize("text", ["\\", "&%$#_{}", "~^", "<>|", "[2cm]", "–", "a\nb", "*", "--", "``"])
def test_nothing_in_latex_is_a_command(text):
    written = latex_escape(text)
    assert not re.search(r"(?<!\\)[&%#_]", written)
    assert "\n" not in written
    assert not written.startswith(("[", "*"))
    latex.shown(written)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_latex_compiles(tmp_path):
    body = rf"\usepackage{{booktabs,graphicx}}\begin{{document}}{latex_tables([TABLE])}\end{{document}}"
    (tmp_path / "t.tex").write_text(rf"\documentclass{{article}}{body}")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


def printed(**options) -> str:
    stream = io.StringIO()
    Console(file=stream, width=120, **options).print(terminal_table(TABLE))
    return stream.getvalue()


def test_the_terminal_shows_narrow_headings_and_all_cells():
    text = printed()
    assert "\x1b" not in text
    assert "cover" in text
    assert "Coverage" not in text
    assert all(cell in text for row in TABLE.texts for cell in row[:5])
    assert "two" not in text
    assert re.search(r"\x1b\[1;32m *0\.333", printed(force_terminal=True, color_system="standard"))


def test_a_narrow_terminal_leaves_out_the_wide_columns_the_last_first():
    columns = [Column(key, key, kind="number", wide=key != "a") for key in "abc"]
    table = Table("", tuple(columns), (TableRow((111, 222, 333)),))
    for width, shown, left_out in (
        (15, "111  222  333", ""),
        (14, "111  222", "c"),
        (9, "111", "b, c"),
        (1, "111", "b, c"),
    ):
        stream = io.StringIO()
        Console(file=stream, width=80).print(terminal_table(table, width=width))
        above, _, below = stream.getvalue().partition("Left")
        assert shown in map(str.strip, above.splitlines())
        assert "".join(below.split()) == (f"outatthiswidth:{left_out}.".replace(" ", "") if left_out else "")


def test_sentences_take_several_lines_before_columns_give_way():
    columns = (Column("name", "name"), Column("n", "n", kind="number", wide=True), Column("what", "what"))
    table = Table("", columns, (TableRow(("slam-mini", 12345, "a dive of twenty seconds " * 6)),))

    def text(width):
        stream = io.StringIO()
        Console(file=stream, width=width).print(terminal_table(table, width=width))
        return stream.getvalue()

    assert "12345" in text(64)
    assert "12345" not in text(50)
    assert all("slam-mini" in text(width) for width in (50, 64)), "in one piece"


def test_a_name_is_not_broken_into_letters_by_the_numbers_beside_it():
    numbers = [Column(key, key, kind="number") for key in "abcde"]
    row = TableRow(("gtsam_vi", "a long name of a method", *[123456789012] * 5))
    table = Table("", (Column("name", "name"), Column("other", "other"), *numbers), (row,))
    stream = io.StringIO()
    Console(file=stream, width=80).print(terminal_table(table, width=80))
    assert re.search(r"^ gtsam_vi  a long name", stream.getvalue(), re.MULTILINE)


class Cells(HTMLParser):
    """Gathers rows of a table; checks that tags nest."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.titles: list[str] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag != "wbr":
            self.open.append(tag)
        self.titles += [value for name, value in attrs if name == "title"]
        if tag == "tr":
            self.rows.append([])
        if tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"th", "td"} & set(self.open):
            self.rows[-1][-1] += data


def test_html_holds_every_shown_cell_escaped_with_definitions_and_reasons():
    cells = Cells(html_table(TABLE))
    assert [row[:5] for row in TABLE.texts[:2]] == [tuple(row) for row in cells.rows[1:3]]
    assert cells.rows[0][1].split() == ["Score", "↑"]
    assert cells.rows[3][0] == "mean of 2"
    assert "Area under recall." in cells.titles
    assert "one sequence" in cells.titles


def test_html_links_within_the_site_and_to_the_web_alone():
    cells = (Cell("a", path="/a"), Cell("b", url="https://b"), Cell("c", url="javascript:alert(1)"))
    bar = Cell(0.5, bar=Bar(0.25, 0.5, 0.75))
    table = Table("t", tuple(map(Column, "abcd")), (TableRow((*cells, bar)),))
    html = html_table(table)
    assert "javascript" not in html
    assert 'href="https://b"' in html
    assert 'href="/a"' not in html  # nobody said where the site's pages are
    assert 'x="25.0"' in html


def test_numbers_of_what_diverged_have_no_decimals():
    column = Column("ate", "ATE", kind="number", digits=3)
    assert column.texts([0.5, 9999.5, 83837.354, -10000.0]) == ["0.500", "9999.500", "83837", "\N{MINUS SIGN}10000"]


def test_an_interval_may_stand_below_its_number_where_a_page_is_narrow():
    html = html_table(TABLE)
    assert '2.00 <span class="around">[1.00 to 3.00]</span>' in html
    assert html.count("around") == 1, "0.5 has no interval"


def test_a_rounded_zero_has_no_sign():
    column = Column("difference", kind="number", digits=1, signed=True)
    assert column.texts([-0.04, 0.0, 0.04, -0.06]) == ["0.0", "0.0", "0.0", "\N{MINUS SIGN}0.1"]


def test_an_interval_is_shown_with_the_decimals_that_tell_it_from_zero():
    column = Column("difference", kind="interval", digits=1, factor=100.0, signed=True)
    near, across = Interval(-0.004, -0.0002), Interval(-0.0002, 0.004)
    assert column.resolving([near, across]).text(near) == "\N{MINUS SIGN}0.40 to \N{MINUS SIGN}0.02"
    assert column.resolving([across, Interval(math.nan, math.nan, "too few")]) == column
    assert column.resolving([Interval(1e-30, 1.0)]).digits == 7
