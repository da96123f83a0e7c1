"""Results are compared where they may be, kept apart where not, and ties are called ties."""

from __future__ import annotations

import json
from typing import Any

import pytest

from oysterbench.core.errors import ResultError
from oysterbench.results.comparison import as_plain, boards
from oysterbench.results.named import named_results
from oysterbench.results.records import write_results
from oysterbench.results.remarks import remarks
from tests.results.test_results import record


def runs(method: str, scores, water=None, **changes):
    """One record per score, on sequences s0, s1, ...; a score of None is a failed run."""
    found = []
    for i, score in enumerate(scores):
        conditions = {"water": water[i % len(water)], "secchi_m": float(i)} if water else {}
        values: dict[str, Any] = (
            {"metrics": {"score": score, "coverage": 1.0}} if score is not None else {"metrics": {}}
        )
        values["failure"] = None if score is not None else "lost"
        found.append(record(method=method, sequence=f"s{i}", **{**values, "conditions": conditions, **changes}))
    return found


GOOD, BAD = [0.9, 0.8, 0.85, 0.9, 0.95, 0.7, 0.8, 0.9], [0.3, 0.2, 0.1, 0.4, 0.3, 0.2, 0.3, 0.2]


def test_methods_are_ranked_by_the_score_with_ties():
    near = [score + (0.02 if i % 2 else -0.02) for i, score in enumerate(GOOD)]
    (board,) = boards([*runs("bad", BAD), *runs("good", GOOD), *runs("near", near)])
    assert [(row.label, row.standing.rank) for row in board.standings][2] == ("bad", 3)
    assert {row.label: row.standing.rank for row in board.standings} == {"good": 1, "near": 1, "bad": 3}
    pair = next(pair for pair in board.pairs if {pair.a, pair.b} == {"good", "bad"})
    assert (pair.comparison.verdict, pair.comparison.wins, pair.comparison.losses) == ("better", 8, 0)
    assert pair.comparison.interval.low > 0.4


def test_a_failed_run_scores_zero_in_the_standings():
    (board,) = boards([*runs("a", [0.8, None]), *runs("b", [0.5, 0.5])])
    first, second = board.standings
    assert (first.label, second.label) == ("b", "a")
    assert (second.failures, second.runs, second.summaries["score"].mean) == (1, 2, 0.4)


def test_methods_that_all_failed_share_the_last_place_at_zero():
    (board,) = boards([*runs("a", [None, None]), *runs("b", [None, None])])
    assert [row.standing.place for row in board.standings] == [1, 1]
    assert all(row.summaries["score"].mean == 0.0 for row in board.standings)
    assert "ate_rmse_m" not in board.standings[0].summaries


def test_nothing_to_compare_is_no_board():
    assert boards([]) == []
    assert remarks([]) == []


def test_one_sequence_has_places_and_says_why_there_are_no_ranks():
    found = boards([*runs("a", [0.9]), *runs("b", [0.2])])
    assert [(row.label, row.standing.place, row.standing.rank) for row in found[0].standings] == [
        ("a", 1, None),
        ("b", 2, None),
    ]
    assert remarks(found) == ["1 sequence: no 95% interval is possible with fewer than 6"]


@pytest.mark.parametrize(
    ("change", "remark"),
    [
        ({"settings": {"align": "se3"}}, 'setting align ("posyaw", "se3")'),
        ({"evaluator_version": "slam 9"}, "evaluator (slam 1, slam 9)"),
        ({"split_digest": "cd" * 32}, "recipe of the split"),
        ({"split": "other"}, "split (slam-mini, other)"),
    ],
)
def test_what_differs_in_more_than_the_method_is_kept_apart(change, remark):
    found = boards([*runs("a", [0.9]), *runs("b", [0.8], **change)])
    assert [len(board.standings) for board in found] == [1, 1]
    assert remarks(found)[0] == f"shown as 2 separate comparisons, since they differ in {remark}"


def test_settings_that_only_another_track_has_are_not_told_of():
    found = boards([*runs("a", [0.9]), *runs("b", [0.8], track="steering", split="steer-mini", settings={"start": 0})])
    assert remarks(found)[0] == (
        "shown as 2 separate comparisons, since they differ in track (slam, steering), split (slam-mini, steer-mini)"
    )


def test_many_values_are_counted_and_not_listed():
    found = boards([one for k in range(7) for one in runs("a", [0.9], settings={"align": "se3", "step": k})])
    assert remarks(found)[0].endswith("setting step (0, 1, 2, 3 and 3 more)")


def test_methods_that_differ_in_many_settings_have_short_labels_all_of_their_own():
    many = [{f"k{i}": i + (i == 9 and n) for i in range(10)} | {"other": n // 9} for n in range(3)]
    found = boards([one for given in many for one in runs("a", [0.9], method_settings=given)])
    labels = [entry.label for entry in found[0].entries]
    assert len(set(labels)) == 3
    assert max(map(len, labels)) < 60


@pytest.mark.parametrize(
    ("ends", "shown"),
    [
        (("good", "rc3"), ("good", "rc3")),
        (("--config cfg/a.yaml", "--config cfg/a/b.yaml"), ("cfg/a.yaml", "cfg/a/b.yaml")),
        (("--config a 1", "--config a 2", "--config b"), ("a 1", "a 2", "b")),
        (("", "-v"), ("{out}", "-v")),
    ],
)
def test_long_commands_of_one_name_are_told_apart_by_what_differs(ends, shown):
    start = "/usr/lib/slam/bin/a_program_with_a_long_name {mcap} {out}"
    given = [{"command": f"{start} {end}".strip(), "poses_of": "base"} for end in ends]
    found = boards([one for settings in given for one in runs("mine", [0.9], method_settings=settings)])
    labels = [entry.label for entry in found[0].entries]
    for label, part in zip(labels, shown, strict=True):
        assert label.startswith("mine (command = ")
        assert label.endswith(f"{part})")
        assert "#" not in label
    assert len(set(labels)) == len(ends)


def test_commands_that_differ_in_two_far_places_are_shown_whole():
    commands = [f"prog {{mcap}} {a} {'x' * 50} {b} {{out}}" for a in "mn" for b in "op"]
    found = boards([one for each in commands for one in runs("mine", [0.9], method_settings={"command": each})])
    assert [entry.label for entry in found[0].entries] == [f"mine (command = {each})" for each in commands]


def test_standings_are_over_the_sequences_that_all_were_run_on():
    found = boards([*runs("a", [0.5, 0.5]), *runs("b", [0.4, 0.6, 1.0])])
    assert (found[0].sequences, found[0].left_out) == (("s0", "s1"), ("s2",))
    assert [row.standing.place for row in found[0].standings] == [1, 1]
    assert any("without s2" in remark for remark in remarks(found))
    assert [cell.sequence for cell in found[0].cells()].count("s2") == 1


def test_a_file_given_twice_counts_once():
    (board,) = boards([*runs("a", [0.5]), *runs("a", [0.5])])
    assert board.standings[0].runs == 1


def test_results_of_different_runs_are_not_written_out_to_be_compared(monkeypatch):
    def costly(self) -> str:
        raise AssertionError

    records = [*runs("a", [0.5, 0.5]), *runs("b", [0.5]), *runs("a", [0.5], run=1)]
    monkeypatch.setattr(type(records[0]), "to_json", costly)
    (board,) = boards(records)
    assert [len(entry.records) for entry in board.entries] == [3, 1]


def test_the_same_file_scored_again_later_or_elsewhere_counts_once(tmp_path):
    first = runs("a", [0.5], created="2026-01-01T00:00:00Z")
    later = runs("a", [0.5], created="2026-01-02T00:00:00Z", hardware={"cpu": "another"})
    assert boards([*first, *later])[0].standings[0].runs == 1
    for name, records in (("a.json", first), ("b.json", later), ("c.json", runs("a", [0.6]))):
        write_results(tmp_path / name, records)
    assert named_results([str(tmp_path / "a.json"), str(tmp_path / "b.json")]) == first
    with pytest.raises(ResultError, match=r"both hold run 0 of a on s0, with different numbers"):
        named_results([str(tmp_path / "a.json"), str(tmp_path / "c.json")])


def test_one_method_with_two_settings_is_two_methods():
    records = [*runs("a", [0.5], method_settings={"k": 1, "m": 2}), *runs("a", [0.6], method_settings={"k": 3, "m": 2})]
    (board,) = boards(records)
    assert [row.label for row in board.standings] == ["a (k = 3)", "a (k = 1)"]


def test_two_truths_under_one_name_are_refused():
    with pytest.raises(ResultError, match="sequence 's0' was scored against 2 different truths"):
        boards([*runs("a", [0.5], truth_digest="x"), *runs("b", [0.5], truth_digest="y")])


def test_an_unknown_track_is_refused():
    with pytest.raises(ResultError, match="track 'cooking': expected one of slam"):
        boards(runs("a", [0.5], track="cooking"))


def test_classes_of_conditions_are_compared_on_their_own():
    water = ("clear", "turbid")
    a = [0.9 if i % 2 else 0.1 for i in range(16)]
    b = [0.1 if i % 2 else 0.9 for i in range(16)]
    (board,) = boards([*runs("a", a, water), *runs("b", b, water)])
    assert {(pair.condition, pair.value): pair.comparison.sequences for pair in board.pairs} == {
        ("", ""): 16,
        ("water", "clear"): 8,
        ("water", "turbid"): 8,
    }
    verdicts = {(pair.a, pair.value): pair.comparison.verdict for pair in board.pairs}
    assert verdicts["a", ""] == "not significantly different"
    assert (verdicts["a", "clear"], verdicts["a", "turbid"]) == ("worse", "better")
    assert [(value, label, round(s.mean, 3)) for value, label, s in board.strata("water")][:2] == [
        ("clear", "a", 0.1),
        ("clear", "b", 0.9),
    ]
    assert board.strata("light") == []
    assert list(board.varying()) == ["secchi_m"]


def test_cells_give_median_range_and_failures_of_the_runs():
    records = [*runs("a", [0.5]), *runs("a", [0.9], run=1), *runs("a", [None], run=2)]
    ((cell,)) = boards(records)[0].cells()
    assert (cell.runs, cell.failures, cell.median, cell.low, cell.high) == (3, 1, 0.5, 0.0, 0.9)


def test_a_board_is_strict_json():
    (board,) = boards([*runs("a", [0.5, None]), *runs("b", [0.4, 0.6])])
    values = json.loads(json.dumps(as_plain(board), allow_nan=False))
    assert values["standings"][0]["method"] == "b"
    assert values["pairs"][0]["interval"]["low"] is None
    assert values["pairs"][0]["interval"]["reason"].startswith("2 sequences")


def test_boards_of_one_split_are_told_apart_by_name_and_records_by_label():
    found = boards([*runs("a", [0.9]), *runs("a", [0.8], settings={"align": "se3"})])
    assert [board.name for board in found] == ["slam-mini (align = posyaw)", "slam-mini (align = se3)"]
    (board,) = boards([*runs("a", [0.5], method_settings={"k": 1}), *runs("a", [0.6], method_settings={"k": 3})])
    assert [kept.method for kept in board.records] == ["a (k = 1)", "a (k = 3)"]


def test_what_a_board_knows_is_cut_to_the_tracks_and_splits_of_the_files(tmp_path):
    write_results(tmp_path / "mine.json", runs("mine", [0.5]))
    of_slam, of_density = runs("theirs", [0.6]), runs("theirs", [0.7], track="density")
    known = {"theirs": [*of_slam, *of_density, *runs("theirs", [0.8], split="slam-val")], "counter": of_density}
    given = named_results([str(tmp_path / "mine.json"), "theirs"], known.get)
    assert given[1:] == of_slam
    assert named_results(["theirs"], known.get) == known["theirs"]
    assert named_results([str(tmp_path / "mine.json"), "counter"], known.get)[1:] == of_density


def test_labels_and_paths_may_contain_the_sign_between_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("k=1", "k=2"):
        write_results(tmp_path / name / "results.json", runs("mine", [0.5]))
    asked = ["base=k=1", "k=2", "window=9=k=1"]
    assert [one.method for one in named_results(asked)] == ["base", "mine", "window=9"]
    known = {"mono[mask=fish]": runs("mono[mask=fish]", [0.5])}
    assert [one.method for one in named_results(["a=mono[mask=fish]"], known.get)] == ["a"]
    with pytest.raises(ResultError, match=r"^k=3: no such file"):
        named_results(["base=k=3"])


def test_labelled_files_are_not_looked_up_on_a_board_that_may_not_work(tmp_path):
    for name in ("one", "two"):
        write_results(tmp_path / name, runs("mine", [0.5]))

    def find(name):
        raise FileExistsError(name)

    assert [each.method for each in named_results([f"{name}={tmp_path / name}" for name in ("one", "two")], find)] == [
        "one",
        "two",
    ]


def test_a_method_with_options_is_named_as_on_the_board():
    known = {name: runs(name, [0.5]) for name in ("mono", "mono[mask=fish]", "mono[mask=fish,k=2]")}

    def find(name):  # as the board does
        if name not in known:
            raise ResultError(f"{name}: no such method")
        return known[name]

    asked = ["mono[mask=fish]", "mono[mask=fish,k=2]", "a=b=mono", "mine=mono[mask=fish]"]
    assert [one.method for one in named_results(asked, find)] == [*asked[:2], "a=b", "mine"]
    for name, meant in (("mono[mask=fis]", "mono[mask=fis]"), ("a=mono[mask=fis]", "mono[mask=fis]")):
        with pytest.raises(ResultError) as error:
            named_results([name], find)
        assert str(error.value) == f"{meant}: no such method"


def test_boards_of_two_tracks_are_told_apart_by_their_evaluators_alone():
    found = boards([*runs("a", [0.9]), *runs("a", [0.8], track="density", evaluator_version="density 2", settings={})])
    assert [board.name for board in found] == ["slam-mini (slam 1)", "slam-mini (density 2)"]
