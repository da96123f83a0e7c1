"""What becomes of the results that a folder holds when more are written into it."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.results.records import read_results, replaced
from tests.results.test_results import record


@pytest.fixture
def evaluate(trajectories, tmp_path):
    """Score a file into the folder `out`."""

    def call(estimate, *options):
        words = ["eval", "slam", "--truth", trajectories[0], "--estimate", estimate, "--out", tmp_path / "out"]
        return CliRunner().invoke(main, [*map(str, words), *options, "--json"])

    return call


def test_results_of_other_methods_stay_and_those_of_the_same_are_replaced(evaluate, trajectories, tmp_path):
    truth, mine = trajectories
    theirs, out = tmp_path / "theirs.tum", tmp_path / "out"
    theirs.write_bytes(truth.read_bytes())
    assert "stay" not in evaluate(mine).stderr
    done = evaluate(theirs)
    # What is printed is what was asked for.
    assert [row["method"] for row in json.loads(done.stdout)["results"]] == ["theirs.tum"]
    assert (
        f"{out}: results of 1 earlier run are kept beside these, without figures: mine.tum; "
        f"`oysterbench compare {out}` shows them together\n"
    ) in done.stderr
    assert [record.method for record in read_results(out / "results.json")] == ["mine.tum", "theirs.tum"]
    for name in ("results.csv", "results.md", "results.tex", "report.html"):
        text = (out / name).read_text()
        assert "mine" in text, name
        assert "theirs" in text, name
    assert evaluate(mine, "--align", "se3").exit_code == 0
    found = {record.method: record.settings["align"] for record in read_results(out / "results.json")}
    assert found == {"theirs.tum": "posyaw", "mine.tum": "se3"}


def test_a_folder_whose_results_cannot_be_read_is_left_as_it_is(evaluate, trajectories, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "results.json").write_text("[1]")
    done = evaluate(trajectories[1])
    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1
    assert "results.json: expected an object with the list 'results'" in done.stderr
    assert "it was left unchanged: move it away, or choose another --out" in done.stderr
    assert (tmp_path / "out" / "results.json").read_text() == "[1]"


def test_only_what_would_not_be_the_same_again_is_told_as_replaced():
    three = [record(run=k) for k in range(3)]
    assert replaced(three, three) == []
    assert replaced(three[:1], three) == []
    assert replaced(three, [record(method="another")]) == []
    assert replaced(three, three[:1]) == ["the results of 3 runs of dead_reckoning on mini-01 by 1"]
    (told,) = replaced([*three, record(run=3, settings={"align": "se3"})], three)
    assert told == "the result of dead_reckoning on mini-01, of another ground truth, evaluator or settings"
