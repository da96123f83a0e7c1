"""`oysterbench compare`: any results beside each other, and what it refuses."""

from __future__ import annotations

import json

import pytest

from oysterbench.results.records import ResultRecord, write_results
from tests.helpers.command import assert_one_line, run


@pytest.fixture
def two_results(trajectories, tmp_path):
    """Two folders of results: one estimate under two names, scored against one truth."""
    truth, estimate = trajectories
    other = estimate.with_name("theirs.tum")
    other.write_text(estimate.read_text())
    for name, path in (("ours", estimate), ("theirs", other)):
        arguments = ("--truth", truth, "--estimate", path, "--align", "none", "--out", tmp_path / name)
        assert run("eval", "--track", "slam", *arguments).returncode == 0
    return tmp_path / "ours", tmp_path / "theirs"


def test_compare_ranks_any_results_and_equal_ones_tie(two_results):
    result = run("compare", *two_results, "--json")
    assert result.returncode == 0, result.stderr
    document = json.loads(result.stdout)
    (board,) = document["comparisons"]
    assert [(row["method"], row["place"], row["rank"]) for row in board["standings"]] == [
        ("mine.tum", 1, None),
        ("theirs.tum", 1, None),
    ]
    (pair,) = board["pairs"]
    assert (pair["verdict"], pair["ties"], pair["difference"]) == ("not significantly different", 1, 0.0)
    assert document["remarks"] == ["1 sequence: no 95% interval is possible with fewer than 6"]
    table = run("compare", *two_results).stdout
    assert "Standings on truth.tum" in table
    assert "Pairs on truth.tum" in table


def test_a_result_of_another_truth_or_setting_that_is_replaced_is_told_of(trajectories, tmp_path):
    truth, estimate = trajectories
    words = ("eval", "--track", "slam", "--estimate", estimate, "--out", tmp_path / "out")
    first = run(*words, "--truth", truth, "--align", "none")
    again = run(*words, "--truth", truth, "--align", "none")
    assert (first.returncode, again.returncode) == (0, 0), first.stderr + again.stderr
    assert "replaced" not in first.stderr + again.stderr, "the same again is no loss"
    assert f"replaced the result of {estimate.name} on {truth.name}" in run(*words, "--truth", truth).stderr
    other = tmp_path / truth.name
    other.write_text("\n".join(truth.read_text().splitlines()[:-5]) + "\n")
    assert "of another ground truth, evaluator or settings" in run(*words, "--truth", other).stderr


def test_paths_are_compared_before_the_maps_that_are_made_along_them(tmp_path):
    common = {"split": "slam-val", "sequence": "val-01", "metrics": {"score": 0.5, "coverage": 1.0}}
    write_results(
        tmp_path / "results.json",
        [ResultRecord(track=track, method=name, **common) for track in ("density", "slam") for name in ("a", "b")],
    )
    result = run("compare", tmp_path, "--json")
    assert result.returncode == 0, result.stderr
    assert [board["track"] for board in json.loads(result.stdout)["comparisons"]] == ["slam", "density"]


def test_results_of_an_unknown_track_are_refused_by_those_that_there_are(tmp_path):
    record = ResultRecord(track="sonar", split="slam-val", sequence="val-01", method="a", metrics={"score": 0.5})
    write_results(tmp_path / "results.json", [record])
    assert_one_line(run("compare", tmp_path), "track 'sonar': expected one of slam, ")


def test_compare_writes_all_forms_and_its_json_is_alone_on_stdout(two_results, tmp_path):
    forms = [f"--{form}={tmp_path / form}" for form in ("csv", "tex", "md", "report")]
    result = run("compare", *two_results, *forms, "--json")
    assert json.loads(result.stdout)["comparisons"]
    assert all((tmp_path / form).stat().st_size > 100 for form in ("csv", "tex", "md", "report"))


def test_compare_keeps_other_settings_apart_and_says_so(two_results, trajectories, tmp_path):
    truth, estimate = trajectories
    arguments = ("--truth", truth, "--estimate", estimate, "--align", "se3", "--out", tmp_path / "other")
    assert run("eval", "--track", "slam", *arguments).returncode == 0
    result = run("compare", two_results[0], tmp_path / "other", "--json")
    document = json.loads(result.stdout)
    assert len(document["comparisons"]) == 2
    assert 'shown as 2 separate comparisons, since they differ in setting align ("none", "se3")' in document["remarks"]


def test_compare_asks_for_labels_where_two_files_say_to_be_the_same_run(two_results, trajectories, tmp_path):
    truth, estimate = trajectories
    worse = tmp_path / "again" / "mine.tum"
    worse.parent.mkdir()
    worse.write_text("\n".join(estimate.read_text().splitlines()[:100]))
    arguments = ("--truth", truth, "--estimate", worse, "--align", "none", "--out", tmp_path / "again")
    assert run("eval", "--track", "slam", *arguments).returncode == 0
    first, second = two_results[0], tmp_path / "again"
    assert_one_line(run("compare", first, second), "both hold run 0 of mine.tum .*oysterbench compare A=")
    result = run("compare", f"before={first}", f"after={second}", "--json")
    labels = [row["method"] for row in json.loads(result.stdout)["comparisons"][0]["standings"]]
    assert labels == ["before", "after"]


def test_compare_refuses_what_is_no_result_in_one_line(tmp_path):
    (tmp_path / "empty.json").write_text('{"results": []}')
    (tmp_path / "other.json").write_text("[1]")
    assert_one_line(run("compare", tmp_path / "absent.json"), "absent.json: no such file")
    assert_one_line(run("compare", tmp_path / "empty.json"), "holds no result")
    assert_one_line(run("compare", tmp_path / "other.json"), "expected an object with the list 'results'")


def test_results_of_one_track_are_taken_and_those_that_there_are_named(two_results):
    one = run("compare", *two_results, "--track", "slam", "--json")
    assert one.stdout == run("compare", *two_results, "--json").stdout
    refused = run("compare", *two_results, "--track", "steering")
    assert_one_line(refused, "expected results of the track steering, got slam on own data")
