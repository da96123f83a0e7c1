"""The command `run`, as its users type it: streams, exit codes, resuming after a kill."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from pathlib import Path

import pytest

import oysterbench
from oysterbench.core.trajectory import write_tum
from oysterbench.recipe import load_split
from oysterbench.results.records import read_results
from oysterbench.simulation.generate import digest, generate_split, split_folder
from tests.helpers.command import run as run_here
from tests.helpers.paths import COMMAND
from tests.helpers.programs import command
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT
from tests.helpers.waiting import until

pytestmark = pytest.mark.usefixtures("inputs_here")


def start(*arguments, **options):
    words = [COMMAND, "run", *map(str, arguments)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def run(*arguments, **options):
    process = start(*arguments, **options)
    out, err = process.communicate()
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)


@pytest.fixture
def answer(tmp_path, dive_file):
    """The true poses of the hand-made dive as a TUM file."""
    path = tmp_path / "work" / "answer.tum"  # programs write beside it, and cannot do so beside the results
    path.parent.mkdir()
    write_tum(path, oysterbench.open(dive_file).truth())
    return path


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_program_is_run_scored_and_compared(dive_file, answer, tmp_path):
    out = tmp_path / "out"
    done = run("mine", "--command", command(tmp_path, "copies", answer), "--on", dive_file, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    (result,) = json.loads(done.stdout)["results"]
    assert result["method"] == "mine"
    assert result["metrics"]["ate_rmse_m"] < 1e-9
    assert "running mine on hand-made, run 1 (1 of 1)" in done.stderr
    assert {path.name for path in out.iterdir()} >= {"results.json", "report.html", "hand-made-mine.tum", "runs"}
    compared = subprocess.run([COMMAND, "compare", out, "--json"], capture_output=True, text=True, check=False)
    assert compared.returncode == 0, compared.stderr


def test_of_a_split_only_the_topics_that_are_wanted_are_rendered(home, tmp_path):
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    recipe = tmp_path / "tiny.toml"
    recipe.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "rig.toml"'))
    wanted = ("run", "dead_reckoning", "--split", recipe, "--topics", "/imu")
    done = run_here(*wanted)
    assert done.returncode == 0, done.stderr
    assert "frames" not in done.stderr
    (kept,) = home.rglob("results.json")
    assert kept.parent.parent.name.startswith("topics-")
    (record,) = read_results(kept)
    split = load_split(str(recipe))
    assert (record.split, record.split_digest) == ("tiny", digest(split))
    assert record.info["topics"] == ["/imu", "/tf_static", "/truth/odometry", "/truth/pose"]
    assert record.metrics["coverage"] > 0.9
    generate_split(split, split_folder(split))
    whole = run_here("run", "dead_reckoning", "--split", recipe)
    assert whole.returncode == 0, whole.stderr
    (other,) = read_results(split_folder(split) / "runs" / "results.json")
    assert "topics" not in other.info
    assert (other.truth_digest, other.metrics["score"]) == (record.truth_digest, record.metrics["score"])
    for words, why in (
        (("dead_reckoning", "--on", kept), "--topics chooses from a split"),
        (("unet", "--split", "seg-mini"), "segmentation needs complete sequences"),
    ):
        refused = run_here("run", *words, "--topics", "/imu", "--out", tmp_path / "out")
        assert refused.returncode != 0
        assert why in refused.stderr


def test_maps_need_of_a_split_one_camera_with_its_layers(home, tmp_path):
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    recipe = tmp_path / "tiny.toml"
    recipe.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "rig.toml"'))
    wanted = ("run", "dead_reckoning", "--track", "density", "--split", recipe, "--sequence", "tiny-01", "--topics")
    refused = run_here(*wanted, "/cam_front/image", "--topics", "/imu")
    assert refused.returncode == 1
    assert "tiny-01: no camera has the layers depth, class and instance" in refused.stderr
    assert not list(home.rglob("*.mcap")), "refused before anything is rendered"
    done = run_here(*wanted, "/cam_front/*", "--topics", "/imu")
    assert done.returncode == 0, done.stderr
    (kept,) = home.rglob("results.json")
    assert kept.parent.name == "runs-density"
    found = {record.method: record for record in read_results(kept)}
    assert found["true poses"].info["topics"][:2] == ["/cam_front/camera_info", "/cam_front/class"]
    split = load_split(str(recipe))
    generate_split(split, split_folder(split), names=["tiny-01"])
    whole = run_here(*wanted[:-1])
    assert whole.returncode == 0, whole.stderr
    for record in read_results(split_folder(split) / "runs-density" / "results.json"):
        assert "topics" not in record.info
        assert record.metrics == found[record.method].metrics, "the map is of the same camera"


def test_a_failed_run_is_one_line_and_exit_code_1(dive_file, answer, tmp_path):
    template = command(tmp_path, "refuses", answer)
    done = run_here("run", "--command", template, "--on", dive_file, "--out", tmp_path / "out", "--json")
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert "exit status 3; last output: no vocabulary | giving up; full output: " in last
    assert (Path(last.rpartition(": ")[2]) / "stdout.txt").read_text() == "first\n"
    assert "Traceback" not in done.stderr
    (result,) = json.loads(done.stdout)["results"]
    assert result["metrics"]["score"] == 0.0


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_what_was_finished_survives_and_the_same_command_goes_on(number, dive_file, answer, tmp_path):
    arguments = ("mine", "--command", command(tmp_path, "waits", answer), "--on", dive_file)
    arguments = (*arguments, "--runs", "2", "--jobs", "1", "--out", tmp_path / "out")
    pid_file, log = Path(f"{answer}.pid"), Path(f"{answer}.log")
    process = start(*arguments)
    until(lambda: pid_file.is_file() and pid_file.read_text() and (tmp_path / "out/results.json").is_file(), process)
    assert [record.run for record in read_results(tmp_path / "out/results.json")] == [0]
    process.send_signal(number)
    _, err = process.communicate()
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert (
            "interrupted; finished runs are kept, and the same command resumes from there: oysterbench run mine" in err
        )
    pid = int(pid_file.read_text())
    until(lambda: not is_alive(pid))  # its supervisor hears of the death and ends it
    Path(f"{answer}.go").touch()
    done = run(*arguments)
    assert done.returncode == 0, done.stderr
    assert "run 2 (1 of 1)" in done.stderr
    assert log.read_text() == "run\n" * 3  # the first, the one that was stopped, and that one again
    assert [record.run for record in read_results(tmp_path / "out/results.json")] == [0, 1]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
@pytest.mark.slow
def test_jobs_that_run_side_by_side_all_end_and_all_go_on(number, dive_file, answer, tmp_path):
    arguments = ("mine", "--command", command(tmp_path, "holds", answer, "mcap", "{seed}"), "--on", dive_file)
    arguments = (*arguments, "--runs", "3", "--jobs", "2", "--out", tmp_path / "out")
    pid_files = [Path(f"{answer}.pid{k}") for k in (1, 2)]
    process = start(*arguments)
    until(
        lambda: (
            all(path.is_file() and path.read_text() for path in pid_files) and (tmp_path / "out/results.json").is_file()
        ),
        process,
    )
    process.send_signal(number)
    process.communicate()
    pids = [int(path.read_text()) for path in pid_files]
    until(lambda: not any(map(is_alive, pids)))
    Path(f"{answer}.go").touch()
    done = run(*arguments)
    assert done.returncode == 0, done.stderr
    assert sorted(Path(f"{answer}.log").read_text().split()) == ["0", "1", "1", "2", "2"]
    assert [record.run for record in read_results(tmp_path / "out/results.json")] == [0, 1, 2]


def test_a_sequence_without_truth_gives_poses_and_no_score(dive_file, answer, tmp_path):
    from oysterbench.methods.interfaces.slam import write_input

    write_input(dive_file, "mcap", tmp_path / "hidden.mcap")
    template = command(tmp_path, "copies", answer)
    done = run_here("run", "mine", "--command", template, "--on", tmp_path / "hidden.mcap", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "hand-made has no ground truth to score against; the predictions: " in done.stderr
    assert (tmp_path / "out/hand-made-mine.tum").is_file()
    assert read_results(tmp_path / "out/results.json") == []


@pytest.mark.slow
def test_a_split_is_rendered_and_run_on(tmp_path):
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    recipe = tmp_path / "tiny.toml"
    recipe.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "rig.toml"'))
    environment = {**os.environ, "OYSTERBENCH_HOME": str(tmp_path / "home")}
    done = run("dead_reckoning", "--split", recipe, "--sequence", "tiny-01", "--json", env=environment)
    assert done.returncode == 0, done.stderr
    (result,) = json.loads(done.stdout)["results"]
    assert result["split"] == "tiny"
    assert result["conditions"]["water_type"] == "1C"
    assert result["metrics"]["coverage"] == 1.0


def test_what_another_program_reached_stays_in_the_folder(dive_file, answer, tmp_path):
    out = tmp_path / "out"
    for name in ("first", "second", "first"):
        done = run_here("run", name, "--command", command(tmp_path, "copies", answer), "--on", dive_file, "--out", out)
        assert done.returncode == 0, done.stderr
    assert [record.method for record in read_results(out / "results.json")] == ["second", "first"]
    assert f"{out}: results of 1 earlier run are kept beside these, without figures: second" in done.stderr


def test_runs_whose_results_are_replaced_are_told_of_once(dive_file, answer, tmp_path):
    out = tmp_path / "out"

    def told(*options):
        program = command(tmp_path, "copies", answer)
        done = run_here("run", "mine", "--command", program, "--on", dive_file, "--out", out, *options)
        assert done.returncode == 0, done.stderr
        return [line for line in done.stderr.splitlines() if "replaced" in line]

    assert told("--runs", 2) == told("--runs", 2) == []
    assert told("--runs", 2, "--max-gap", 0.5) == [
        f"{out}: replaced the result of mine on hand-made, of another ground truth, evaluator or settings: another "
        "--out keeps both"
    ]
    assert told("--max-gap", 0.5) == [
        f"{out}: replaced the results of 2 runs of mine on hand-made by 1: another --out keeps both"
    ]


def test_a_program_that_fails_is_a_row_beside_others_in_every_file_of_the_folder(dive_file, answer, tmp_path):
    out = tmp_path / "out"
    for name, program, code in (("never", "refuses", 1), ("good", "copies", 0)):
        done = run_here("run", name, "--command", command(tmp_path, program, answer), "--on", dive_file, "--out", out)
        assert done.returncode == code, done.stderr
    for file in ("results.md", "results.tex", "report.html", "results.csv"):
        text = (out / file).read_text()
        rows = [line for line in re.sub(r"</td>\n|<t[hd][^>]*>", " ", text).splitlines() if "hand-made" in line]
        assert any("never" in row for row in rows), file
        assert any("good" in row for row in rows), file
    compared = run_here("compare", out)
    assert compared.returncode == 0, compared.stderr
    assert [line.split()[1] for line in compared.stdout.splitlines() if line.split()[:1] in (["(1)"], ["(2)"])] == [
        "good",
        "never",
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "expected either --split SPLIT or --on SEQUENCE"),
        (("--split", "slam-mini"), "expected a METHOD, or --command"),
        (
            ("a", "b", "--split", "slam-mini", "--command", "x {euroc} {out}"),
            "expected at most one name for it, got a, b",
        ),
        (("a", "--split", "slam-mini", "--poses-of", "imu"), "a Python method gives the poses of base_link"),
        (("--split", "slam-mini", "--command", "x {euroc} {out}", "--set", "a=1"), "are for Python methods"),
        (("a", "--on", "x.mcap"), "--on needs --out"),
        (("a", "--on", "x.mcap", "--out", "o", "--sequence", "s"), "--sequence chooses from a split"),
    ],
)
def test_a_request_that_contradicts_itself_is_a_usage_error(arguments, message):
    done = run_here("run", *arguments)
    assert done.returncode == 2
    assert message in done.stderr


@pytest.mark.slow
def test_variants_of_a_method_stand_in_one_table(dive_file, tmp_path):
    arguments = ("dead_reckoning", "--set", "imu_inflation=2", "--ablate", "start.level_s=0.5", "--on", dive_file)
    wide = {**os.environ, "COLUMNS": "160"}  # or names are wrapped
    done = run(*arguments, "--out", tmp_path / "out", env=wide)
    assert done.returncode == 0, done.stderr
    plain, ablated = read_results(tmp_path / "out/results.json")
    assert plain.method == "dead_reckoning[imu_inflation=2]"
    assert ablated.method == "dead_reckoning[imu_inflation=2,start.level_s=0.5]"
    assert (plain.method_settings, ablated.method_settings) == (
        {"imu_inflation": 2.0},
        {"imu_inflation": 2.0, "start.level_s": 0.5},
    )
    assert ablated.info["settings"]["start"]["level_s"] == 0.5
    assert plain.metrics["ate_rmse_m"] != ablated.metrics["ate_rmse_m"]
    assert "[imu_inflation=2" in done.stdout


def test_a_frame_that_a_sequence_does_not_have_is_refused_before_anything_runs(dive_file, answer, tmp_path):
    words = ("--command", command(tmp_path, "copies", answer), "--on", dive_file, "--out", tmp_path / "out")
    done = run_here("run", "mine", *words, "--poses-of", "moon")
    assert done.returncode != 0
    assert "--poses-of moon: sequence hand-made has no such frame; expected base, imu, camera or" in done.stderr
    assert "running" not in done.stderr
    assert not (tmp_path / "out" / "results.json").exists()


def test_an_unknown_option_is_one_line_with_those_like_it(home):
    done = run_here("run", "dead_reckoning", "--ablate", "level_s=1", "--split", "slam-mini")
    assert done.returncode == 1
    assert "method 'dead_reckoning' has no option 'level_s'; did you mean start.level_s? Its " in done.stderr
    assert "the fields of oysterbench_baselines.dead_reckoning" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not home.exists()


def test_an_unknown_method_is_named_before_anything_is_rendered(home):
    done = run_here("run", "orb_slam", "--split", "slam-mini")
    assert done.returncode == 1
    assert "unknown method 'orb_slam'; did you mean orb_slam3_mono? installed methods: " in done.stderr
    assert "module:Class" in done.stderr
    assert not home.exists()


def test_tuning_ranks_its_trials_and_goes_on_in_its_folder(tmp_path):
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    (tmp_path / "tiny.toml").write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "rig.toml"'))
    (tmp_path / "ranges.toml").write_text("[speed_m_s]\nrange = [0.1, 0.9]\n")
    method = "oysterbench_baselines.template:Template"
    words = ["tune", method, "--split", tmp_path / "tiny.toml", "--sequence", "tiny-01", "--trials", 3]
    words += ["--ranges", tmp_path / "ranges.toml", "--out", tmp_path / "out"]
    done = run_here(*words, home=tmp_path / "home")
    assert done.returncode == 0, done.stderr
    scores = {record.method: record.metrics["score"] for record in read_results(tmp_path / "out" / "results.json")}
    assert len(scores) == 3
    best = max(scores, key=scores.__getitem__)
    assert done.stdout.splitlines()[-1] == best.replace("template", method)
    again = run_here(*words, home=tmp_path / "home")
    assert again.stdout == done.stdout
    assert "running" not in again.stderr
    some = run_here(*words[:-1], tmp_path / "some", "--topics", "/imu", home=tmp_path / "home")
    assert some.returncode == 0, some.stderr
    assert "rendering" not in some.stderr, "copied from the complete file"
    topics = {tuple(record.info["topics"]) for record in read_results(tmp_path / "some" / "results.json")}
    assert topics == {("/imu", "/tf_static", "/truth/odometry", "/truth/pose")}
