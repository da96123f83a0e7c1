"""What pages say, and their other representations, with no server in between."""

from __future__ import annotations

import csv
import io
import re

import pytest

from oysterbench.evaluate.metrics import find_metric
from oysterbench.results.comparison import boards
from oysterbench.results.records import ResultRecord
from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site import render, standing
from oysterbench_leaderboard.site.page import Page, PageError
from oysterbench_leaderboard.site.pages.board import board_page, parse_query
from oysterbench_leaderboard.site.pages.compare import compare_page
from oysterbench_leaderboard.site.pages.data import data_page, split_page
from oysterbench_leaderboard.site.pages.home import home_page
from oysterbench_leaderboard.site.pages.literature import literature_page
from oysterbench_leaderboard.site.pages.log import log_page
from oysterbench_leaderboard.site.pages.method import method_page
from oysterbench_leaderboard.site.pages.prose import about_page, submit_page
from oysterbench_leaderboard.site.pages.record import record_page
from oysterbench_leaderboard.site.paths import slug
from oysterbench_leaderboard.site.representations import represent
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import NASTY, records_made
from tests.helpers.site_made import LITERATURE, Reading, make_site


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_site(tmp_path_factory.mktemp("board"))


@pytest.fixture(scope="module")
def site(made):
    return made[0]


@pytest.fixture(scope="module")
def digests(made):
    return made[1]


@pytest.fixture(scope="module")
def pages(site, digests) -> dict[str, Page]:
    """One of each kind, those with nasty names among them."""
    found = [
        home_page(site),
        board_page(site, "slam", "slam-val"),
        board_page(site, "segmentation", "seg-val"),
        board_page(site, "detection", "seg-val"),
        board_page(site, "steering", "steer-val"),
        *(method_page(site, slug(method)) for method in ("carp", "fraud", *(m for m, _ in NASTY))),
        *(record_page(site, digests[name]) for name in ("carp1", "carp2", "gap", "unet", "fraud", "nasty0", "nasty2")),
        *(record_page(site, digests[name]) for name in ("boxes", "steer")),
        compare_page(site, "steer", "straight"),
        compare_page(site, digests["carp2"], digests["nasty0"]),
        compare_page(site, "unet", "colour"),
        data_page(site),
        split_page(site, "slam-val"),
        split_page(site, "slam-test"),
        literature_page(site),
        submit_page(site),
        log_page(site),
        about_page(site),
    ]
    return {f"{page.path} {page.title}": page for page in found}


def html(page: Page) -> str:
    return render.page_html(page, render.server_links())


def test_every_page_is_whole_html_with_labels_captions_and_one_heading(pages):
    for name, page in pages.items():
        read = Reading(html(page))
        assert not read.wrong, (name, read.wrong)
        assert not read.open, (name, read.open)
        assert len(read.all("h1")) == 1, name
        assert read.all("html") == [{"lang": "en"}]
        assert read.all("a")[0] == {"class": "skip", "href": "#main"}
        assert any(one.get("id") == "main" for one in read.all("main"))
        assert len(read.all("caption")) == len(read.all("table")), name
        assert all(one.get("scope") in ("col", "row") for one in read.all("th")), name
        ids = {one["id"] for _, one in read.elements if "id" in one}
        labelled = {one.get("for") for one in read.all("label")}
        for field in read.all("input"):
            inside = field.get("type") in ("checkbox", "hidden")  # a tick stands in its label, or is named
            assert inside or field.get("id") in labelled, (name, field)
        assert labelled - {None} <= ids
        for one in read.all("svg"):
            assert one.get("aria-label") or one.get("aria-hidden") or "viewbox" not in one or "role" not in one, name


def test_no_name_becomes_markup_and_no_script_stands_in_a_page(pages):
    for name, page in pages.items():
        read = Reading(html(page))
        for tag, attributes in read.elements:
            assert not any(key.startswith("on") or key == "style" for key in attributes), (name, tag, attributes)
            # The nasty names hold others.
            assert tag != "img" or str(attributes["src"]).startswith("/static/frame-"), name
        assert all(one.get("src") for one in read.all("script")), name
        assert not any(link.strip().lower().startswith("javascript:") for link in read.links()), name
    shown_text = Reading(html(pages["/boards/slam/slam-val SLAM on slam-val"])).text
    for method, team in NASTY:
        assert method in shown_text
        assert team in shown_text


def test_ranks_are_those_of_the_index_and_ties_are_marked(site):
    rows = site.index.page(site.index.boards("slam")[0].id, Query()).rows
    table = board_page(site, "slam", "slam-val").table
    shown = [texts[0] for texts in table.texts]
    assert [text.lstrip("=") for text in shown] == [str(row.rank) for row in rows]
    assert shown[:2] == ["=1", "=1"]
    for text, row in zip(shown, rows, strict=True):
        assert text.startswith("=") == (sum(other.rank == row.rank for other in rows) > 1)
    assert [texts[1] for texts in method_page(site, "cod").table.texts] == ["=1 of 8"]
    # On a page of one row nothing else tells of the tie.
    assert board_page(site, "slam", "slam-val", None, Query(size=1)).table.texts[0][0] == "=1"
    first = next(iter(home_page(site).context["cards"].values()))[0]
    assert [leader.rank.text for leader in first.leaders[:2]] == ["=1", "=1"]


def test_a_board_is_sorted_filtered_and_paged_as_asked(site):
    def methods(**asked):
        page = board_page(site, "slam", "slam-val", None, parse_query({k: [v] for k, v in asked.items()}))
        return [texts[1] for texts in page.table.texts]

    everyone = methods()
    assert methods(q="HARBOUR") == [m for m in everyone if m in ("cod", "gap", "eel")]
    assert methods(tier="baseline") == ["carp", "drift"]
    assert methods(state="withdrawn") == ["fraud"]
    assert methods(state="superseded") == ["carp"]
    assert methods(sort="score", order="asc") == everyone[::-1]
    assert methods(sort="ate_percent")[0] == "carp"
    assert [name for page in "1234" for name in methods(size="2", page=page)] == everyone
    assert methods(size="4") == methods(size="5") == everyone[:5]


@pytest.mark.parametrize(
    ("asked", "shown_text"),
    [
        ({"sort": "beauty"}, "sort: expected rank, method"),
        ({"order": "up"}, "order: expected asc or desc"),
        ({"tier": "gold"}, "tier: expected baseline, scored, reported"),
        ({"state": "lost"}, "state: expected current"),
        ({"page": "0"}, "page: expected a whole number from 1"),
        ({"page": "1e3"}, "page: expected a whole number"),
        ({"page": "²"}, "page: expected a whole number"),
        ({"size": "100000"}, "size: expected a whole number from 1 to 1000"),
        ({"q": "x" * 101}, "q: expected at most 100 characters"),
        ({"page": "99"}, "page: expected 1 to 1, got 99"),
    ],
)
def test_what_cannot_be_asked_is_told_with_what_can(site, asked, shown_text):
    with pytest.raises(PageError, match=re.escape(shown_text)):
        board_page(site, "slam", "slam-val", None, parse_query({k: [v] for k, v in asked.items()}))


def test_an_unknown_board_names_those_that_are_there(site):
    with pytest.raises(PageError) as told:
        board_page(site, "slam", "slam-nowhere")
    assert told.value.status == 404
    assert "/boards/slam/slam-val" in told.value.hints
    with pytest.raises(PageError) as told:
        board_page(site, "slam", "slam-val", "0" * 16)
    assert any("slam 2" in about for about in told.value.hints.values())


def test_coverage_stands_beside_errors_and_the_interval_beside_the_score(site):
    keys = [column.key for column in board_page(site, "slam", "slam-val").table.columns if not column.hidden]
    assert keys.index("interval") == keys.index("score") + 1
    assert keys.index("coverage") < keys.index("ate_percent")
    assert all(
        column.unit for column in board_page(site, "slam", "slam-val").table.columns if column.key == "ate_percent"
    )


def test_the_value_over_the_whole_data_set_stands_beside_the_mean_that_ranks(site, digests):
    page = board_page(site, "detection", "seg-val")
    shown = {c.key: cell for c, cell in zip(page.table.columns, page.table.rows[0].cells, strict=True) if not c.hidden}
    row = site.index.row(digests["boxes"])
    assert shown["data_set"].value == 0.21
    assert shown["ap_mask"].value == row.score != 0.21
    shown_text = Reading(html(page)).text
    assert f"{find_metric('ap_mask').heading} ranks by its mean over sequences; 'data set' is of all" in shown_text
    record = record_page(site, digests["boxes"])
    means = {texts[8]: texts for texts in record.tables[1].texts}
    assert means["ap_mask"][6:8] == ("0.210", "0.180 to 0.250")
    assert means["pq"][6:8] == ("\N{EN DASH}",) * 2
    assert len(record.table.rows) == 6
    weighed = board_page(site, "segmentation", "seg-val")  # the mean by pixels is the value over the data set
    assert site.index.row(digests["unet"]).data_set == 0.7
    assert all(column.hidden for column in weighed.table.columns if column.key == "data_set")


def test_steering_ranks_by_skill_and_draws_no_bar_of_what_is_below_zero(site, digests):
    page = board_page(site, "steering", "steer-val")
    assert [texts[:2] for texts in page.table.texts] == [
        ("1", "steer"),
        ("2", "straight"),
    ]
    keys = [column.key for column in page.table.columns if not column.hidden]
    assert keys[2] == "skill"
    assert "regret_oysters" in keys
    last = page.table.rows[1].cells
    assert page.table.texts[1][3].startswith("\N{MINUS SIGN}0.")
    assert last[2].bar is None
    assert "steer is better by Skill." in Reading(html(compare_page(site, "straight", "steer"))).text
    failed = standing.filled(standing.named(site.record(digests["steer"]), "steer")[1:], ("dive-01",), ())
    assert standing.means(failed, "skill")["dive-01"] == 0.0


def test_a_withdrawn_record_says_so_and_has_no_rank(site, digests):
    shown_text = Reading(html(record_page(site, digests["fraud"]))).text
    assert "Withdrawn on 2026-11-05: The estimates were made from the truth." in shown_text
    assert "not ranked" in shown_text


def test_a_superseded_record_leads_to_the_one_in_its_place_and_back(site, digests):
    old, new = (Reading(html(record_page(site, digests[name]))) for name in ("carp1", "carp2"))
    assert f"/records/{digests['carp2']}" in old.links()
    assert "A longer window." in old.text
    assert f"/records/{digests['carp1']}" in new.links()


def test_a_record_page_shows_each_sequence_and_what_was_not_answered(site, digests):
    table = record_page(site, digests["gap"]).table
    assert [texts[0] for texts in table.texts] == [f"val-0{i}" for i in range(1, 9)]
    last = table.rows[-1]
    assert last.cells[0].mark == "not answered"
    assert last.cells[1].value == 0.0
    failed = record_page(site, digests["eel"]).table.rows[-1]
    assert failed.kind == "failed"
    assert failed.cells[1].value == 0.0
    assert failed.cells[2].value is None  # a failed run has no error


def test_the_means_of_a_record_page_are_those_of_its_board(site, digests):
    for name in ("carp2", "gap", "eel", "unet"):
        page, row = record_page(site, digests[name]), site.index.row(digests[name])
        mean = next(line for line in page.tables[1].rows if line.cells[8].value == page.context["info"].metric)
        assert mean.cells[2].value == pytest.approx(row.score, abs=1e-12)
        assert [mean.cells[3].value.low, mean.cells[3].value.high] == pytest.approx([row.low, row.high], abs=1e-9)


def test_paths_are_drawn_over_the_truth_with_what_is_missing_left_out(site, digests):
    drawn = record_page(site, digests["carp2"]).context["drawings"]
    assert [drawing.title for drawing in drawn] == [f"val-0{i}" for i in range(1, 9)]
    above = drawn[-1].cards[0].plot
    assert above.count('<path class="c0"') == 1
    estimate = re.search(r'<path class="c1"[^>]* d="([^"]+)"', above)
    assert estimate[1].count("M") == 2  # lifted where there is no answer
    nasty = str(record_page(site, digests["nasty0"]).context["drawings"][0])
    assert "<script" not in nasty
    assert record_page(site, digests["drift"]).context["drawings"] == []


def test_curves_that_are_not_as_they_should_be_are_left_out(tmp_path):
    from oysterbench_leaderboard.site.charts import drawings

    good = {"run": 0, "t_s": [0, 1], "truth": [[0, 0, 0], [1, 0, 0]], "path": [[0, 0, 0], None], "error_m": [0, None]}
    for bad in (
        {**good, "truth": [[0, 0]]},
        {**good, "t_s": "soon"},
        {**good, "error_m": [None, None]},
        {key: value for key, value in good.items() if key != "path"},
    ):
        assert drawings({"a": {"sequences": {"x": bad}}}) == []
    assert len(drawings({"a": {"sequences": {"x": good}}})) == 1
    assert drawings({"a": {"sequences": []}}) == []


def test_head_to_head_says_what_the_paired_comparison_says(site, digests):
    page = compare_page(site, digests["carp2"], digests["drift"])
    records = records_made()
    results: list[ResultRecord] = [*records["carp2"].results, *records["drift"].results]
    pair = next(pair for pair in boards(results)[0].pairs if not pair.condition)
    assert page.data["difference"]["difference"] == pytest.approx(pair.comparison.difference)
    assert page.data["difference"]["wins"] == pair.comparison.wins == 8
    assert "carp is better by Score." in Reading(html(page)).text
    back = compare_page(site, digests["drift"], digests["carp2"])
    assert back.data["difference"]["difference"] == pytest.approx(-pair.comparison.difference)
    assert "carp is better by Score." in Reading(html(back)).text
    assert {(p["condition"], p["value"]) for p in page.data["pairs"]} >= {
        ("", ""),
        ("water", "clear"),
        ("water", "murky"),
    }


def test_head_to_head_counts_what_was_not_answered_as_the_board_does(site, digests):
    page = compare_page(site, digests["cod"], digests["gap"])
    a, b = (site.index.row(digests[name]).score for name in ("cod", "gap"))
    assert page.data["difference"]["difference"] == pytest.approx(a - b)
    assert page.data["difference"]["sequences"] == 8


def test_methods_are_compared_by_their_names(site, digests):
    page = compare_page(site, "carp", slug(NASTY[0][0]))
    assert page.query == {"a": digests["carp2"], "b": digests["nasty0"]}
    with pytest.raises(PageError, match="expected a record's digest or a method"):
        compare_page(site, "carp", "whale")
    with pytest.raises(PageError, match="got nothing"):
        compare_page(site, "carp", "")
    with pytest.raises(PageError, match="got the same one twice"):
        compare_page(site, digests["cod"], digests["cod"])


def test_records_of_two_evaluators_are_not_compared_and_it_is_told_why(site, digests):
    with pytest.raises(PageError, match=re.escape("differ in evaluator (slam 3, slam 2)")) as told:
        compare_page(site, digests["carp2"], digests["old"])
    assert told.value.status == 409


def test_a_failed_clip_weighs_what_its_truth_weighs(site, digests):
    record = site.record(digests["unet"])
    whole = standing.named(record, "unet")
    names = tuple(dict.fromkeys(result.sequence for result in whole))
    filled = standing.filled(whole[1:], names, whole)
    lost = next(result for result in filled if result.sequence == whole[0].sequence)
    assert lost.metrics["iou"] == 0.0
    assert lost.metrics["union_px"] == whole[0].metrics["truth_px"]


def test_the_log_tells_of_withdrawals_and_successors(site, digests):
    events = {(event["action"], event["record"]["digest"]): event for event in log_page(site).data["events"]}
    assert events["withdrawn", digests["fraud"]]["reason"] == "The estimates were made from the truth."
    assert events["superseded", digests["carp1"]]["by"]["digest"] == digests["carp2"]


def test_literature_stands_alone_and_is_never_ranked(site, pages):
    shown_text = html(literature_page(site))
    assert "never ranked with ours" in shown_text
    assert "ORB-SLAM &lt;b&gt;" in shown_text
    for name, page in pages.items():
        if not page.path.startswith("/literature"):
            assert LITERATURE[0].method not in Reading(html(page)).text, name


def test_a_hidden_split_shows_neither_recipe_nor_seed(site):
    hidden, public = split_page(site, "slam-test"), split_page(site, "slam-val")
    assert public.data["recipe"]
    assert public.data["seed"]
    assert hidden.data["recipe"] == ""
    assert "seed" not in hidden.data
    assert "[[sequence]]" not in html(hidden)
    assert "ground truth withheld" in html(hidden)


def test_csv_runs_nothing_in_a_spreadsheet_and_has_every_digit(site, pages):
    for page in pages.values():
        for line in csv.reader(io.StringIO(represent(page, ".csv").decode())):
            for field in line:
                number = re.fullmatch(r"-?[0-9.]+(e[+-]?\d+)?", field)
                assert number or not field.lstrip().startswith(("=", "+", "-", "@", "\t", "\r")), field
    rows = list(csv.DictReader(io.StringIO(represent(board_page(site, "slam", "slam-val"), ".csv").decode())))
    first = site.index.row(rows[0]["record"])
    assert float(rows[0]["score"]) == first.score
    assert rows[0]["interval_low"] == repr(first.low)
    assert rows[-2]["method"] == NASTY[2][0]
    assert any(row["method"] == f"'{NASTY[1][0]}" and row["team"] == f"'{NASTY[1][1]}" for row in rows)


def test_tex_holds_no_command_that_is_not_ours(pages):
    ours = r"begin|end|centering|caption|label|toprule|midrule|bottomrule|textbackslash|textasciitilde|textasciicircum"
    ours += r"|textless|textgreater|textbar|textsuperscript|downarrow|uparrow|times"
    ours += r"|textbf|resizebox|ifdim|width|linewidth|else|fi"
    for name, page in pages.items():
        for line in represent(page, ".tex").decode().split("\n"):
            code = re.split(r"(?<!\\)%", line)[0]
            rest = re.sub(rf"\\(?:{ours})(?![a-zA-Z])|\\[&%$#_{{}},\\]", "", code)
            assert "\\" not in rest, (name, line)
            assert not re.search(r"[#^~]", rest), (name, line)
        assert represent(page, ".tex").decode().count("\\begin{tabular}") == len(page.tables)


def test_a_name_has_one_slug_that_is_safe_in_addresses_and_files():
    names = ("gtsam_vi", "GTSAM_VI", "../../etc/passwd", "a.json", "con", "名", "", "x" * 80, *(m for m, _ in NASTY))
    slugs = [slug(name) for name in names]
    assert len(set(slugs)) == len(names)
    assert all(re.fullmatch(r"[a-z0-9][a-z0-9_+~-]{0,79}", one) for one in slugs)
    assert slug("gtsam_vi") == "gtsam_vi"


def test_an_empty_board_has_pages_too(tmp_path):
    store = RecordStore(tmp_path / "board")
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    for page in (home_page(site), log_page(site), literature_page(site), data_page(site), about_page(site)):
        assert not Reading(html(page)).wrong
    assert "No record has been published yet" in html(home_page(site))
