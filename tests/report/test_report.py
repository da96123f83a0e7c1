"""The terminal table reads well in a pipe; the HTML report is whole, escaped, self-contained and legible."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from xml.etree import ElementTree

import numpy as np
import pytest
from rich.console import Console

from oysterbench.core import page
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.slam.scoring import EVALUATOR, SlamSettings, score
from oysterbench.report import (
    SlamRun,
    csv_text,
    html_report,
    latex_text,
    markdown_text,
    results_table,
    terminal_table,
    write_html_report,
)
from oysterbench.report.columns import metric_column
from oysterbench.report.plots import Curve, recall_plot, scatter_plot
from oysterbench.results.records import ResultRecord

VOID = {"meta", "br", "img", "wbr"}
JPEG = b"\xff\xd8\xff\xe0 not a picture \xff\xd9"


def loop(duration_s: float = 20.0, rate_hz: float = 50.0) -> Trajectory:
    t = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    positions = np.column_stack([4 * np.cos(t / 3), 3 * np.sin(t / 3), -3 + 0.2 * np.sin(t)])
    stamps = 1_700_000_000 * 10**9 + np.round(t * 1e9).astype(np.int64)
    return Trajectory(stamps, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))


def run(method: str, sigma_m: float = 0.01, sequence: str = "mini-01", keep: slice = slice(None), **changes) -> SlamRun:
    rng = stream(9, b"", method, sequence)
    truth = loop()
    walk = np.cumsum(rng.normal(0, sigma_m, (len(truth), 3)), axis=0)
    estimate = replace(truth, positions=truth.positions + walk).select(keep)
    result = score(truth, estimate)
    values = {
        "track": "slam",
        "split": "slam-mini",
        "split_digest": "ab" * 32,
        "sequence": sequence,
        "method": method,
        "metrics": {**result.metrics, "realtime_factor": 2.0, "cpu_s_per_s": 0.75, "peak_memory_mb": 512.0},
        "reasons": result.reasons,
        "notes": result.notes,
        "settings": SlamSettings().as_dict(),
        "evaluator_version": EVALUATOR,
    }
    return SlamRun(ResultRecord(**{**values, **changes}), result, [(int(truth.stamps_ns[50]), JPEG)])


def failed(method: str, sequence: str = "mini-01") -> SlamRun:
    record = run(method, sequence=sequence).record
    return SlamRun(replace(record, metrics={}, failure="it <crashed> & burned"))


def printed(runs: list[SlamRun], width: int = 80, **options) -> str:
    stream_ = StringIO()
    Console(file=stream_, width=width, **options).print(
        terminal_table(results_table([r.record for r in runs]), titled=False, width=width)
    )
    return stream_.getvalue()


# --- the table -----------------------------------------------------------------------------------------------------


def test_table_in_a_pipe_has_no_colour_and_fits_80_columns():
    text = printed([run("gtsam_vi", 0.0004), run("dead_reckoning", 0.5)])  # of errors with many digits
    assert "\x1b" not in text
    assert max(len(line.rstrip()) for line in text.splitlines()) <= 80
    line = next(line for line in text.splitlines() if "dead_reckoning" in line)
    slam = TRACKS["slam"]
    assert line.split()[:2] == ["mini-01", "dead_reckoning"]
    assert len(line.split()) == 2 + len({*slam.table, *slam.costs} - {*slam.wide})


def test_a_wide_terminal_and_every_file_have_processor_time_and_memory_beside_the_speed():
    runs = [run("gtsam_vi")]
    line = next(line for line in printed(runs, width=120).splitlines() if "gtsam_vi" in line)
    assert line.split()[-3:] == ["2.0", "0.75", "512"]
    records = [each.record for each in runs]
    assert all("CPU" in text and "Memory" in text for text in (markdown_text(records), latex_text(records)))
    assert ">0.75</td>" in html_report(runs, "oysterbench eval slam")
    assert {"cpu_s_per_s", "peak_memory_mb"} <= {*csv_text(records).partition("\n")[0].split(",")}


def test_what_no_run_has_measured_has_no_column():
    (only,) = [run("gtsam_vi", metrics={"score": 0.5})]
    assert "CPU" not in printed([only], width=120)


def test_coverage_is_never_rounded_up():
    coverage = metric_column("coverage")
    assert coverage.texts([1.0, 0.9999, 0.5, None, float("nan")]) == ["100.0", "99.9", "50.0", "–", "–"]


def test_small_errors_get_another_decimal_all_over_their_column():
    ate = metric_column("ate_rmse_m")
    assert ate.texts([0.25, 12.5]) == ["0.250", "12.500"]
    assert ate.texts([0.25, 0.0042]) == ["0.2500", "0.0042"]


def test_a_failure_is_a_row_without_errors_and_a_sentence():
    text = printed([run("gtsam_vi"), failed("mine")], width=120)
    (line,) = [line for line in text.splitlines() if line.split()[:2] == ["mini-01", "mine"]]
    assert line.split()[2:] == ["0.000", "–", "–", "–", "–", "0.0", "–", "–", "–"]
    assert "mine on mini-01 failed: it <crashed> & burned" in text


def test_means_are_shown_for_more_than_one_sequence():
    runs = [run("a"), run("a", sequence="mini-02"), failed("b"), run("b", sequence="mini-02")]
    names = [texts[0] for texts in results_table([r.record for r in runs]).texts]
    assert names == ["mini-01", "mini-01", "mini-02", "mini-02", "over 2", "over 2, 1 lost"]
    assert "mean" not in printed([run("a")])


def test_the_best_is_sought_among_runs_that_answer_nearly_all():
    runs = [run("whole", 0.05), run("worse", 0.2), run("tenth", 0.0001, keep=slice(0, 100))]
    best = {row.cells[1].value: row.cells[3].kind for row in results_table([r.record for r in runs]).rows}
    assert best == {"whole": "best", "worse": "", "tenth": ""}
    (alone,) = results_table([run("alone").record]).rows
    assert not any(cell.kind for cell in alone.cells)


def test_the_best_is_marked_in_colour_on_a_terminal():
    assert "\x1b[1;32m" in printed([run("a"), run("b", 0.1)], force_terminal=True, color_system="standard", width=100)


# --- the report ----------------------------------------------------------------------------------------------------


class Tags(HTMLParser):
    """Checks that tags nest, and gathers attributes and text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str, str | None]] = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        self.attributes += [(tag, *attribute) for attribute in attrs]

    def handle_startendtag(self, tag, attrs):
        self.attributes += [(tag, *attribute) for attribute in attrs]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data


def parsed(html: str) -> Tags:
    tags = Tags()
    tags.feed(html)
    assert tags.open == []
    return tags


EVERYTHING = [
    run("gtsam_vi"),
    run("dead_reckoning", 2.0),
    run("<script>alert('x')</script>", 0.02, keep=slice(0, 200)),
    failed("mine"),
    run("gtsam_vi", sequence='a "quoted" & <b>bold</b> name'),
]


def test_report_is_well_formed_and_holds_everything():
    tags = parsed(html_report(EVERYTHING, "oysterbench eval slam-mini --method 'a<b'"))
    for part in (
        "oysterbench eval slam-mini --method 'a<b'",
        "Seen from above",
        "Seen from the side",
        "Height over time",
        "Position error over time",
        "Rotation error over time",
        "alignposyaw",
        "Position error: x (east)",
        "Attitude error: yaw",
        EVALUATOR,
        "mine on mini-01 failed: it <crashed> & burned",
        "1.00 s",
        "1700000001.000000000",
        "over 2",
        "the errors cover only 20% of the sequence",
    ):
        assert part in tags.text, part
    for key in TRACKS["slam"].table:
        assert metric_column(key, track="slam").about in tags.text


def test_where_nobody_says_where_north_is_no_axis_is_called_north():
    known = run("gtsam_vi")
    other = replace(known, record=replace(known.record, split="", split_digest=""))
    for shown, north in ((known, True), (other, False)):
        text = html_report([shown], "oysterbench eval")
        assert ("north" in text, "x (east)" in text, "Position error: x<" in text) == (north, north, not north)


def test_names_are_escaped_and_nothing_is_fetched_or_run():
    html = html_report(EVERYTHING, "oysterbench eval", title="</title><script>")
    tags = parsed(html)
    assert html.count("<script") == 1  # the report's own
    script = html[html.index("<script") : html.index("</script")]
    assert not re.search(r"fetch|XMLHttpRequest|import\b|https?://(?!www.w3.org/2000/svg)|eval\(", script)
    assert "<b>bold" not in html
    assert "<script>alert('x')</script>" in tags.text
    for tag, name, value in tags.attributes:
        assert name not in ("href", "onload", "onclick"), tag
        assert name != "src" or value.startswith("data:image/jpeg;base64,")
    assert "url(" not in html
    assert "@import" not in html


def test_every_measured_metric_is_defined_with_its_unit_and_direction():
    text = parsed(html_report([run("gtsam_vi")], "x")).text
    measured = run("gtsam_vi").record.metrics
    assert len(measured) > 30
    for key in measured:
        assert metric_column(key, track="slam").about in text, key
        assert key in text, key
    assert "Score ↑" in text


def many(**changes) -> list[SlamRun]:
    runs = []
    for i in range(7):
        conditions = {"water": "clear" if i % 2 else "turbid", "secchi_m": 0.5 + i, "path": "loop"}
        for k, method in enumerate(("good", "bad")):
            sigma_m = 0.005 * (1 + 20 * k)
            runs.append(run(method, sigma_m, f"dive-{i}", conditions=conditions, **changes))
    return runs


def test_several_sequences_begin_with_the_standings_and_end_with_conditions():
    html = html_report(many(), "x")
    text = parsed(html).text
    order = [
        "Standings on",
        "By sequence",
        "Pairs on",
        "pairs are left out: fewer than 6 sequences are too few to tell.",
        "By conditions",
        "Over conditions on",
    ]
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert "Score over Secchi depth" in text
    assert html.count("<details open>") == 1  # of seven sequences the first is open
    assert re.search(r"(?s)good\s*bad\s*everywhere\s*\+0\.\d{3}.*?better", text.replace("</td>", " "))


def test_points_over_a_condition_are_drawn_from_six_sequences_on():
    all_of_them = many()
    few = [run_ for run_ in all_of_them if run_.record.sequence != all_of_them[-1].record.sequence]
    names = sorted({run_.record.sequence for run_ in few})
    assert len(names) == 6
    assert "Over conditions on" in html_report(few, "x")
    assert "Over conditions on" not in html_report([r for r in few if r.record.sequence != names[0]], "x")


def test_who_ran_on_files_with_fewer_sensors_is_named():
    fewer = {"topics": ["/cam_left/camera_info", "/cam_left/image", "/imu", "/tf_static", "/truth/pose"]}
    runs = [run("a", info=fewer), run("b"), run("c", info=fewer), run("a", sequence="mini-02", info=fewer)]
    said = "a, c: run on files that have no other sensors than cam_left, imu"
    assert parsed(html_report(runs, "x")).text.count(said) == 1
    assert "run on files" not in parsed(html_report(runs[1:2], "x")).text
    none = parsed(html_report([run("a", info={"topics": ["/truth/odometry"]})], "x")).text
    assert "a: run on files that have no sensors" in none


def test_settings_are_folded_into_a_table_of_one_line_each():
    tags = parsed(html_report([run("a", method_settings={"levels": 3, "flow": {"window_px": 21}})], "x"))
    rows = re.findall(r"(?m)^(flow\.window_px|levels)(.*)$", tags.text)
    assert rows == [("levels", "3"), ("flow.window_px", "21")]
    assert "Settings, versions and machine" in tags.text


def test_a_comparison_without_paths_is_a_page():
    text = parsed(html_report([SlamRun(run_.record) for run_ in many()], "oysterbench compare a b")).text
    assert "Paths are drawn in the report of each evaluation" in text
    assert "Standings on" in text
    assert "could be scored" not in text


def test_of_several_runs_the_median_one_is_drawn():
    def drawn(runs: list[SlamRun]) -> list[str]:
        return re.findall('class="c1" data-label="a" d="([^"]*)"', html_report(runs, "x"))

    runs = [run("a", sigma, run=k) for k, sigma in enumerate((0.001, 0.3, 0.02))]
    assert "the one with the median score is drawn" in html_report(runs, "x")
    assert drawn(runs) == drawn([runs[1], runs[0], runs[2]]) == drawn([runs[2]]) != drawn([runs[0]])


def test_without_scripts_nothing_is_hidden_but_the_hint():
    html = html_report(many()[:4], "x")
    assert re.findall(r"<(\w+)[^>]* hidden>", html) == ["p", "p"]


def test_a_recall_curve_encloses_the_score():
    shown = run("a", 0.02)
    svg = recall_plot(
        [Curve("a", shown.result.recall.error_m / shown.result.recall.scale_m, shown.result.recall.share, 1)],
        "recall",
        "error",
        "share",
    )
    data = re.search('class="c1" data-label="a" d="([^"]*)"', svg).group(1)
    x, y = np.array([[float(v) for v in word.split()] for word in re.split("[ML]", data)[1:]]).T
    left, right = 56.0, 56.0 + 408.0
    bottom = y.max()
    area = np.sum(np.diff(x) * (bottom - y[:-1])) / ((right - left) * 190.0)
    assert area == pytest.approx(shown.record.metrics["score"], abs=0.01)


def test_points_of_a_scatter_plot_stand_where_their_values_are():
    svg = scatter_plot([Curve("a", np.array([0.0, 10.0]), np.array([0.25, np.nan]), 1)], "t", "x", "y", top=1.0)
    (point,) = ElementTree.fromstring(svg).findall(".//polygon")
    _, y = re.fullmatch(r"translate\((\S+) (\S+)\)", point.get("transform")).groups()
    assert float(y) == pytest.approx(32 + 170 * 0.75)


def test_methods_have_points_of_different_shapes():
    curves = [Curve(str(k), np.array([0.0, 1.0]), np.array([0.5, 0.5]), k) for k in range(1, page.STYLES + 1)]
    svg = scatter_plot(curves, "t", "x", "y", top=1.0)
    assert len(set(re.findall('points="([^"]*)"', svg))) == page.STYLES


def test_plots_are_described_for_those_who_do_not_see_them():
    tags = parsed(html_report([run("gtsam_vi")], "oysterbench eval"))
    labels = [value for tag, name, value in tags.attributes if tag == "svg" and name == "aria-label"]
    assert len(labels) == 7 + 6
    assert all("gtsam_vi" in label for label in labels)
    assert all(value for tag, name, value in tags.attributes if tag == "img" and name == "alt")


def test_report_of_failures_alone_is_a_page(tmp_path):
    write_html_report(tmp_path / "sub" / "report.html", [failed("mine")], "oysterbench eval")
    text = (tmp_path / "sub" / "report.html").read_text(encoding="utf-8")
    assert "None of the runs just made on this sequence could be scored" in parsed(text).text
    assert [path.name for path in (tmp_path / "sub").iterdir()] == ["report.html"]


def test_report_of_nothing_is_a_page():
    assert "No runs" in parsed(html_report([], "oysterbench eval")).text


def test_the_same_runs_make_the_same_bytes():
    runs = [run("gtsam_vi", created="2026-01-01T00:00:00Z")]
    assert html_report(runs, "x") == html_report(runs, "x")


def test_truth_that_stands_still_and_a_perfect_estimate_are_drawn():
    still = replace(loop(), positions=np.zeros((1001, 3)))
    result = score(still, still, SlamSettings(align="none"))
    record = run("a").record
    record = replace(record, metrics=result.metrics, reasons=result.reasons)
    assert not re.search(r"\bnan\b", html_report([SlamRun(record, result)], "x"), re.IGNORECASE)
