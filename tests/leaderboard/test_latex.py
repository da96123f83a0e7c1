"""Tables in LaTeX, read by a strict reader: columns, braces, commands, and names as they were."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from oysterbench.report.renderers.latex import NEEDS, latex_escape, latex_tables, needs
from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.boards.tables import board_table, history_table, literature_tables
from oysterbench_leaderboard.site.export import Work, _whole, _work
from oysterbench_leaderboard.site.representations import represent
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.latex import Wrong, needed, read, shown
from tests.helpers.records_made import NASTY, fill, record_made
from tests.helpers.site_made import make_site

NAMES = (
    *(name for pair in NASTY for name in pair),
    "a & b % c _ d # e ^ f ~ g \\ h { i } j $ k",
    "[star] brackets",
    "*star",
    "--help -- and --- more",
    "don't ''quote'' ``this``, !`no?`, ,,low",
    "100 \N{PLUS-MINUS SIGN} 5 \N{MICRO SIGN}m \N{EN DASH} m\N{SUPERSCRIPT TWO}",
    "\\end{tabular}\\end{table}",
    "%",
    "\\\\",
    "&&",
    "| < >",
    'a "b" c',
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The small leaderboard, with more names to stumble over."""
    folder = tmp_path_factory.mktemp("board")
    store = RecordStore(folder)
    fill(store)
    for i, name in enumerate(NAMES):
        store.add(record_made(name, f"team {name}", 0.3 + 0.01 * i, summary=name))
    return Site(
        open_index(store, str(folder / "index.sqlite")), make_site(tmp_path_factory.mktemp("other"))[0].literature
    )


def as_read(text: str) -> str:
    """What stands on paper for a text: mathematics as the reader shows it, and no line breaks."""
    for character in "\N{PLUS-MINUS SIGN}\N{MICRO SIGN}\N{MINUS SIGN}":
        text = text.replace(character, latex_escape(character))
    text = text.replace("\N{SUPERSCRIPT TWO}", "2").replace("\N{SUPERSCRIPT THREE}", "3")
    return " ".join(text.split())


def failing(file: str, why: str) -> None:
    """Fails where a file is left out."""
    pytest.fail(f"{file}: {why}")


def work_of(site: Site) -> list[Work]:
    """The pages of a site none of whose files is damaged."""
    return list(_work(site, _whole(site, failing)[0], failing))


def test_every_page_of_the_site_is_whole_latex(site):
    work = [one for one in work_of(site) if not one.path.startswith("/compare")]
    pairs = [one for one in work_of(site) if one.path.startswith("/compare")]
    assert len(work) > 60
    for one in work + pairs[::17]:
        page = one.make()
        found = read(represent(page, ".tex").decode())
        assert len(found) == len(page.tables), one.path
        for made, table in zip(found, page.tables, strict=True):
            columns = [i for i, column in enumerate(table.columns) if not column.hidden]
            assert len(made.columns) == len(columns)
            assert made.caption == as_read(table.title), one.path
            assert set(made.label) <= set("abcdefghijklmnopqrstuvwxyz0123456789-:")
            units = any(table.columns[i].unit for i in columns)
            assert len(made.rows) == 1 + units + len(table.rows), one.path


def test_names_are_on_paper_what_they_are(site):
    info = site.index.boards("slam")[0]
    rows = site.index.page(info.id, Query(size=100)).rows
    page = next(one for one in work_of(site) if one.path == "/boards/slam/slam-val").make()
    cells = [row[1] for row in read(represent(page, ".tex").decode())[0].rows[2:]]
    assert cells == [as_read(f"{row.method} ({row.team})") for row in rows]
    assert set(NAMES) <= {row.method for row in rows}


def test_tables_of_the_terminal_are_whole_latex(site):
    boards = site.index.boards()
    tables = [board_table(site.index.page(info.id, Query(size=100))) for info in boards]
    tables += [history_table(site.index.method(name), {info.id: info for info in boards}) for name in NAMES]
    tables += literature_tables(site.literature)
    found = read(latex_tables(tables))
    assert [len(table.columns) for table in found] == [len(table.columns) for table in tables]
    assert [len(table.rows) for table in found] == [
        1 + any(column.unit for column in table.columns) + len(table.rows) for table in tables
    ]


@pytest.mark.parametrize("engine", ["pdflatex", "lualatex"])
def test_the_engines_of_tex_set_all_of_it(site, engine, tmp_path):
    """Debian's texlive-latex-recommended and texlive-luatex, where they are."""
    if shutil.which(engine) is None:
        pytest.skip(f"there is no {engine} here")
    wanted = []
    for one in work_of(site):
        written = represent(one.make(), ".tex").decode()
        if read(written) and (engine == "lualatex" or "lualatex" not in needed(written)):
            wanted.append(written)
    assert len(wanted) > 30
    head = ["\\documentclass{article}", "\\usepackage{booktabs,graphicx}"]
    head += ["\\usepackage[T1]{fontenc}"] if engine == "pdflatex" else []
    # TeX holds 18 tables that have no page yet.
    body = "\n".join(wanted).replace("\\end{table}", "\\end{table}\\clearpage")
    paper = tmp_path / "paper.tex"
    paper.write_text("\n".join([*head, "\\begin{document}", body, "\\end{document}", ""]), encoding="utf-8")
    done = subprocess.run(
        [engine, "-interaction=nonstopmode", "-halt-on-error", "-no-shell-escape", paper.name],
        cwd=tmp_path,
        capture_output=True,
        timeout=300,
    )
    log = done.stdout.decode(errors="replace")
    assert done.returncode == 0, log[-2000:]
    assert "Overfull \\hbox" not in log
    assert paper.with_suffix(".pdf").stat().st_size > 10_000


@pytest.mark.parametrize("text", NAMES)
def test_a_text_is_read_as_it_was_written(text):
    assert shown(latex_escape(text)) == as_read(text)
    assert not latex_escape(text).startswith(("[", "*"))


def test_what_pdflatex_does_not_know_is_said_at_the_head():
    assert needs(latex_escape("a \N{MINUS SIGN} b \N{EN DASH} m\N{SUPERSCRIPT TWO}")) == [NEEDS]
    assert needed("\n".join(needs(latex_escape("\u00c1lvarez-Tu\u00f1\u00f3n")))) == {"booktabs", "graphicx", "fontenc"}
    assert needed("\n".join(needs(latex_escape("\u540d")))) == {"booktabs", "graphicx", "lualatex"}
    assert needs("% of \u540d\nplain") == [NEEDS]


@pytest.mark.parametrize(
    "broken",
    [
        ("& b", "& b & c"),
        ("& b", ""),
        ("a &", "a_1 &"),
        ("a &", "50 % &"),
        ("a &", "[a] &"),
        ("a &", "* &"),
        ("a &", "{a &"),
        ("a &", "\\input{x} &"),
        ("a &", "\\textbackslash a &"),
        ("a &", "$x$ &"),
        ("a &", "\u540d &"),
        ("{lr}", "{lrr}"),
        ("% needs", "% has"),
    ],
)
def test_the_reader_stops_where_latex_would(broken):
    good = "\n".join(
        [
            "% needs \\usepackage{booktabs,graphicx}",
            r"\begin{table}",
            r"\centering",
            r"\caption{t}",
            r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
            r"\begin{tabular}{lr}",
            r"\toprule",
            r"x & y \\",
            r"\midrule",
            r"a & b \\",
            r"\bottomrule",
            r"\end{tabular}}",
            r"\end{table}",
        ]
    )
    assert read(good)[0].rows == [["x", "y"], ["a", "b"]]
    with pytest.raises(Wrong):
        read(good.replace(*broken))
