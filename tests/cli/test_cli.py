"""The command line, as its users type it, with exit codes and streams: what tells on a process in one of its own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import oysterbench
from oysterbench.cli.main import main
from oysterbench.recipe import load_split
from oysterbench.simulation.generate import generate_split
from tests.helpers.command import assert_one_line, run, start
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT
from tests.helpers.waiting import until

pytestmark = pytest.mark.usefixtures("inputs_here")


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    """The tiny split as a file, its rig beside it."""
    folder = tmp_path_factory.mktemp("recipe")
    (folder / "rig.toml").write_text(TINY_RIG)
    path = folder / "tiny.toml"
    path.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "rig.toml"'))
    return path


@pytest.fixture(scope="module")
def kept_home(tmp_path_factory):
    """An OYSTERBENCH_HOME that the tests of this file share."""
    return tmp_path_factory.mktemp("home")


def test_help_shows_examples_and_every_command_has_its_own(recipe):
    assert "Examples:" in start("--help").stdout
    for name in main.commands:
        assert "Examples:" in run(name, "--help").stdout


def test_version():
    assert start("--version").stdout == f"oysterbench, version {oysterbench.__version__}\n"


def test_help_loads_no_numpy():
    code = "import sys; sys.argv = ['oysterbench', '--help']; from oysterbench.cli.main import main\n"
    code += "try: main()\nexcept SystemExit: pass\nassert 'numpy' not in sys.modules and 'rich' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.parametrize("words", [["run", "--help"], ["eval", "--help"], ["systems", "--json"]])
def test_what_only_the_work_needs_is_not_loaded_to_tell_of_it(words):
    code = f"import sys; sys.argv = {['oysterbench', *words]}; from oysterbench.cli.main import main\n"
    code += "try: main()\nexcept SystemExit: pass\n"
    code += "heavy = {'scipy.spatial', 'scipy.special', 'scipy.ndimage', 'oysterbench.mapping', 'pandas'}\n"
    code += "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_eval_renders_runs_and_prints_json_and_nothing_else(recipe, kept_home, tmp_path):
    arguments = ("eval", "--track", "slam", "--split", recipe, "--method", "dead_reckoning", "--json")
    first = start(*arguments, "--workers", 1, "--out", tmp_path / "out", home=kept_home)
    assert first.returncode == 0, first.stderr
    assert "rendering tiny: 25 of 25 frames" in first.stderr
    document = json.loads(first.stdout)
    (record,) = document["results"]
    assert (record["track"], record["split"], record["sequence"]) == ("slam", "tiny", "tiny-01")
    assert record["method"] == "dead_reckoning"
    metrics = record["metrics"]
    for key in (
        "ate_rmse_m",
        "ate_percent",
        "ate_rotation_rmse_deg",
        "rpe_1s_translation_rmse_m",
        "rpe_1s_rotation_rmse_deg",
        "coverage",
        "realtime_factor",
    ):
        assert np.isfinite(metrics[key]), key
    assert metrics["coverage"] > 0.95
    assert document["aggregate"][0]["statistics"]["ate_rmse_m"]["mean"] == metrics["ate_rmse_m"]
    assert json.loads((tmp_path / "out" / "results.json").read_text()) == document
    assert "<svg" in (tmp_path / "out" / "report.html").read_text()

    second = run(*arguments, home=kept_home)
    assert "rendering" not in second.stderr, "the second run renders nothing"
    again = json.loads(second.stdout)["results"][0]["metrics"]
    assert again["ate_rmse_m"] == metrics["ate_rmse_m"]


def test_eval_prints_a_table(recipe, kept_home):
    result = run("eval", "--track", "slam", "--split", recipe, "--method", "dead_reckoning", home=kept_home)
    assert result.returncode == 0
    assert re.search(r"tiny-01 +dead_reckoning +\d", result.stdout)


def test_eval_scores_two_files(trajectories):
    truth, estimate = trajectories
    result = run("eval", "--track", "slam", "--truth", truth, "--estimate", estimate, "--align", "none", "--json")
    assert result.returncode == 0, result.stderr
    metrics = json.loads(result.stdout)["results"][0]["metrics"]
    assert metrics["ate_rmse_m"] == pytest.approx(0.1, abs=1e-9)
    assert metrics["coverage"] == 1.0


@pytest.mark.parametrize("align", ["none", "origin", "se3", "posyaw", "sim3"])
@pytest.mark.parametrize("associate", ["interpolate", "nearest"])
def test_eval_takes_every_alignment_and_association(trajectories, align, associate):
    truth, estimate = trajectories
    options = ("--align", align, "--associate", associate)
    result = run("eval", "--track", "slam", "--truth", truth, "--estimate", estimate, *options, "--json")
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["results"][0]["settings"]["align"] == align


@pytest.mark.slow
def test_eval_runs_a_method_several_times_and_says_how_the_runs_spread(recipe, kept_home, tmp_path):
    arguments = ("eval", "--track", "slam", "--split", recipe, "--method", "dead_reckoning", "--runs", "2")
    result = start(*arguments, "--out", tmp_path / "out", home=kept_home)
    assert result.returncode == 0, result.stderr
    assert "running dead_reckoning on tiny-01, run 2 (2 of 2)" in result.stderr
    assert "dead_reckoning (2 runs)" in result.stdout
    assert "Runs on tiny" in result.stdout
    records = json.loads((tmp_path / "out" / "results.json").read_text())["results"]
    assert [record["run"] for record in records] == [0, 1]
    assert records[0]["conditions"]["water_type"] == "1C"
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"results.json", "results.csv", "results.tex", "results.md", "report.html"} <= names
    assert {"tiny-01-truth.tum", "tiny-01-dead_reckoning-1.tum", "tiny-01-dead_reckoning-2.tum"} <= names


def test_eval_writes_the_forms_that_are_asked_for(trajectories, tmp_path):
    truth, estimate = trajectories
    files = ("--csv", tmp_path / "r.csv", "--md", tmp_path / "r.md", "--report", tmp_path / "new" / "r.html")
    result = start("eval", "--track", "slam", "--truth", truth, "--estimate", estimate, "--tex", "-", *files)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("% needs \\usepackage{booktabs,graphicx}")
    assert "mine.tum" in (tmp_path / "r.csv").read_text()
    assert "| truth.tum | mine.tum |" in (tmp_path / "r.md").read_text()
    page = (tmp_path / "new" / "r.html").read_text()
    assert "oysterbench eval --track slam" in re.sub("<[^>]*>", "", page)
    assert f"written: {tmp_path / 'r.csv'}" in result.stderr


def test_an_unknown_split_is_one_line(home):
    result = run("eval", "--track", "slam", "--split", "slam-maxi", home=home)
    assert_one_line(result, "unknown split 'slam-maxi'; did you mean slam-mini or .*`oysterbench splits` lists all")
    assert_one_line(start("render", "slam-maxi", home=home), "unknown split")
    assert not home.exists()


def test_an_unknown_method_is_one_line_before_anything_is_rendered(home):
    assert_one_line(
        run("eval", "--track", "slam", "--method", "magic", home=home), "unknown method 'magic'; installed methods: "
    )
    assert not home.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("eval",),
        ("eval", "--track", "swimming"),
        ("eval", "--track", "slam", "--truth", "a.tum"),
        ("eval", "--track", "slam", "--truth", "a.tum", "--estimate", "b.tum", "--split", "slam-mini"),
        ("eval", "--track", "slam", "--align", "sideways"),
        ("eval", "--track", "slam", "--truth", "a.tum", "--estimate", "b.tum", "--runs", "2"),
        ("eval", "--track", "slam", "--json", "--csv", "-"),
        ("eval", "--track", "slam", "--runs", "0"),
        ("compare",),
        ("render",),
        ("render", "slam-mini", "--workers", "0"),
        ("fly",),
    ],
)
def test_wrong_usage_exits_with_2(arguments):
    result = run(*arguments)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr
    assert "Usage:" in result.stderr


def test_a_bad_estimate_is_one_line_and_writes_nothing(trajectories, tmp_path):
    truth, estimate = trajectories
    lines = estimate.read_text().splitlines()
    cases = {
        "nan.tum": ([*lines[:5], lines[5].replace(lines[5].split()[1], "nan"), *lines[6:]], "nan"),
        "late.tum": ([re.sub(r"^1", "2", line) for line in lines], "overlap|common|time"),
        "short.tum": ([*lines[:3], "1 2 3"], "short.tum:4"),
        "empty.tum": ([], "holds no pose"),
    }
    for name, (content, pattern) in cases.items():
        (tmp_path / name).write_text("\n".join(content))
        out = tmp_path / f"{name}-out"
        result = run("eval", "--track", "slam", "--truth", truth, "--estimate", tmp_path / name, "--out", out)
        assert_one_line(result, f"(?i:{pattern})")
        assert not out.exists()
    result = run("eval", "--track", "slam", "--truth", truth, "--estimate", tmp_path / "absent.tum")
    assert_one_line(result, r"absent\.tum: no such file")


def test_a_damaged_sequence_is_one_line(recipe, kept_home, tmp_path):
    whole = Path(run("render", recipe, home=kept_home).stdout.strip())
    out = tmp_path / "data"
    out.mkdir()
    path = out / whole.name
    path.write_bytes(whole.read_bytes()[:-1000])
    assert_one_line(run("info", path), "truncated or damaged")
    assert_one_line(start("render", recipe, "--out", out), "truncated or damaged.*delete it and render")


def test_render_says_where_the_files_are_and_info_what_is_in_them(recipe, kept_home):
    result = start("render", recipe, home=kept_home)
    assert result.returncode == 0
    path = Path(result.stdout.strip())
    assert path.is_file()
    assert kept_home in path.parents
    facts = json.loads(run("info", path, "--json").stdout)
    assert facts["sequence"] == "tiny-01"
    assert {row["topic"]: row["messages"] for row in facts["topics"]}["/imu"] == 250
    assert "/cam_front/image" in run("info", path).stdout


@pytest.mark.parametrize("form", ["euroc", "tum", "kitti", "coco", "kalibr", "ply"])
def test_export_writes_a_folder_and_prints_it(dive_file, tmp_path, form):
    result = run("export", dive_file, "--format", form, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert result.stdout == f"{tmp_path / 'out'}\n"
    assert any((tmp_path / "out").iterdir())
    assert [path.name for path in tmp_path.iterdir()] == ["out"], "nothing is left beside it"
    again = run("export", dive_file, "--format", form, "--out", tmp_path / "out")
    assert_one_line(again, "already exists and was left unchanged")


def test_export_says_what_is_worth_knowing_as_json_too(dive_file, tmp_path):
    result = run("export", dive_file, "--format", "euroc", "--out", tmp_path / "out", "--no-truth", "--json")
    assert json.loads(result.stdout) == {
        "folder": str(tmp_path / "out"),
        "format": "euroc",
        "notes": ["cam0 is cam_left", "cam1 is cam_right"],
    }
    assert result.stderr == ""
    assert not (tmp_path / "out" / "mav0" / "state_groundtruth_estimate0").exists()


def test_export_offers_every_format_that_there_is():
    from oysterbench.sequence.export import FORMATS

    text = run("export", "--help").stdout
    assert all(re.search(rf"^ +{form} +\w", text, re.M) for form in FORMATS)


def test_an_export_of_nothing_is_one_line(dive_file, tmp_path):
    assert_one_line(
        run("export", tmp_path / "absent.mcap", "--format", "tum", "--out", tmp_path / "out"), "no such file"
    )
    assert_one_line(
        run("export", dive_file, "--format", "coco", "--out", tmp_path / "out", "--no-truth"),
        "which are ground truth",
    )
    assert run("export", dive_file, "--format", "pcap", "--out", tmp_path / "out").returncode == 2
    assert list(tmp_path.iterdir()) == []


def test_view_writes_one_page(dive_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("view", dive_file)
    assert (result.returncode, result.stdout) == (0, "hand-made.html\n"), result.stderr
    assert "cam_right" in (tmp_path / "hand-made.html").read_text()
    assert run("view", dive_file, "--out", tmp_path / "pages" / "mine.html").returncode == 0
    assert (tmp_path / "pages" / "mine.html").is_file()
    part = run("view", dive_file, "--start", 0.5, "--seconds", 1, "--out", tmp_path / "part.html")
    assert part.returncode == 0
    assert "1.0 s from 0.5 s on" in (tmp_path / "part.html").read_text()
    assert_one_line(run("view", dive_file, "--start", 60), "lasts 2.0 s: expected a part of it")
    assert_one_line(run("view", tmp_path / "absent.mcap"), "no such file")


def test_splits_lists_what_is_here(home):
    rows = json.loads(run("splits", "--json", home=home).stdout)["splits"]
    assert any(row["name"] == "slam-mini" and not row["complete"] for row in rows)
    assert "slam-mini" in run("splits", home=home).stdout


def guarded(code, *arguments, **environment):
    """The command, started beside some code of ours."""
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )


def test_ctrl_c_amid_the_imports_is_one_line(tmp_path):
    (tmp_path / "click.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    done = guarded("from oysterbench.__main__ import main; main()", "--help", PYTHONPATH=str(tmp_path))
    assert_one_line(done, "interrupted before anything was done", 130)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interruption_is_one_line_and_the_work_goes_on_from_there_to_the_same_bytes(recipe, tmp_path, number):
    out = tmp_path / "data"
    words = [sys.executable, "-m", "oysterbench", "render", recipe, "--out", out, "--workers", "2"]
    process = subprocess.Popen([str(word) for word in words], stderr=subprocess.PIPE, text=True)
    until(lambda: process.poll() is not None or list(out.glob(".parts/*/*.part")))
    process.send_signal(number)
    _, stderr = process.communicate(timeout=60)
    if process.returncode == 0:
        pytest.skip("the render was done before it could be interrupted")
    assert process.returncode == 128 + number
    assert "Traceback" not in stderr
    assert "leaked" not in stderr
    assert "the same command resumes from there" in stderr.splitlines()[-1]
    assert not (out / "tiny-01.mcap").exists()
    assert run("render", recipe, "--out", out, "--workers", "1").returncode == 0
    (once,) = generate_split(load_split(str(recipe)), tmp_path / "once", workers=1).values()
    assert (out / "tiny-01.mcap").read_bytes() == once.read_bytes()


@pytest.mark.parametrize("words", [["slm"], ["--track", "slm"], ["--track=slm"]])
def test_a_track_that_there_is_not_is_answered_by_those_there_are(words):
    result = CliRunner().invoke(main, ["eval", *words])
    assert result.exit_code == 2
    assert "expected a track, one of slam, segmentation, detection, density, steering, got 'slm'" in result.output
