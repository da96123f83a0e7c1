"""What is told of a hidden split: few numbers, in steps, and enough to rank by."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.results.plausible import check_plausible
from oysterbench.results.records import ResultRecord, write_results
from oysterbench_leaderboard.publishing.contradictions import check_contradictions
from oysterbench_leaderboard.publishing.hidden import COSTS, LEAST_ESTIMATE, STEP, discreet, significant
from oysterbench_leaderboard.publishing.publish import Attribution, records_of
from oysterbench_leaderboard.site.pages.record import NO_PRECISION, metrics_table
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.record_summary import (
    COLUMNS,
    column_means,
    data_set_value,
    means_over_sequences,
    summarise_record,
)
from oysterbench_leaderboard.submissions.catalogue import SCORED
from oysterbench_leaderboard.submissions.scoring import score_predictions
from tests.benchmarks import reconstruction
from tests.benchmarks.reconstruction import Steering, full
from tests.helpers.pool import NAMES, answers, classes, image_names, zipped
from tests.helpers.records_made import record_made
from tests.helpers.submissions_read import npz, opened, wanted_of

BY_SEQUENCE = {
    "slam": {"score", "coverage"},
    "segmentation": {"iou", "union_px", "truth_px"},
    "detection": {"ap_mask"},
    "steering": {"skill"},
}
"""Track -> all that may be told of a sequence."""


def predicted(track: str, folder) -> bytes:
    """Answers of a middling method to all sequences of a split of the track."""
    if track == "slam":
        return answers(folder, sigma_m=0.05)
    if track == "steering":
        head = "stamp_ns,yaw,pitch"
        rows = {name: [f"{image.rpartition('/')[2]},1,2" for image in image_names(k)] for k, name in enumerate(NAMES)}
        return zipped({f"{name}.csv": "\n".join([head, *lines]).encode() for name, lines in rows.items()})
    instances = {name: classes(s, k)[1] for s in range(2) for k, name in enumerate(image_names(s))}
    moved = {name: np.roll(found, 2, axis=1) for name, found in instances.items()}
    return npz(**(moved if track == "detection" else {name: found > 0 for name, found in moved.items()}))


@pytest.fixture
def told(served, tmp_path):
    """What is told of answers on the hidden split of a track."""

    def told(track: str):
        split = {"slam": "pool-test", "steering": "pool-steer"}.get(track, "pool-masks")
        wanted = wanted_of(served, split, track)
        predictions, _ = opened(tmp_path, predicted(track, tmp_path), wanted)
        return score_predictions(predictions, wanted, served[split].truth, "carp", "2026-11-01T00:00:00Z")

    return told


def digits(value: float) -> int:
    """Significant digits of a number."""
    return len(np.format_float_positional(abs(value), trim="-").replace(".", "").strip("0"))


@pytest.mark.parametrize("track", SCORED)
def test_of_a_hidden_split_few_numbers_are_told_and_in_steps(told, track):
    scored = told(track)
    assert set(BY_SEQUENCE) == set(SCORED)
    for result in scored.results:
        assert result.failure is None
        assert set(result.metrics) == BY_SEQUENCE[track]
        for key, value in result.metrics.items():
            if key.endswith("_px"):
                assert digits(value) <= 3
            else:
                assert value == pytest.approx(STEP * round(value / STEP), abs=1e-9)
        check_plausible(result)
        assert result.truth_digest == ""
    assert scored.curves is None
    assert set(scored.data_set) == {"method", "metrics", "means"}
    assert set(scored.data_set["metrics"]) <= {TRACKS[track].ranking}
    assert set(scored.data_set["means"]) == set(TRACKS[track].standing)
    values = [*scored.data_set["metrics"].values(), *scored.data_set["means"].values()]
    assert all(value is None or digits(value) <= 3 for value in values)
    assert sum(value is not None for value in values) > 1


@pytest.mark.parametrize("track", SCORED)
def test_what_is_told_ranks_and_fills_the_columns_of_a_board(told, track):
    scored = told(track)
    record = Record(method="carp", team="t", tier="scored", results=scored.results, data_set=scored.data_set)
    again = Record.from_dict(record.to_dict())
    assert set(summarise_record(again).scores.values) == set(NAMES)
    means = column_means(again)
    assert set(means) == set(COLUMNS[track])
    assert {key: means[key] for key in scored.data_set["means"]} == scored.data_set["means"]
    shown = {row.cells[-1].value: row.cells[2].value for row in metrics_table(again.results, "x", again.data_set).rows}
    assert {key: shown[key] for key, mean in means.items() if mean is not None and key != "coverage"} == {
        key: mean for key, mean in means.items() if mean is not None and key != "coverage"
    }
    assert data_set_value(again) == scored.data_set["metrics"].get(TRACKS[track].ranking)


@pytest.mark.parametrize("track", SCORED)
def test_what_is_told_is_no_contradiction(told, track):
    scored = told(track)
    record = Record(method="carp", team="t", tier="scored", results=scored.results, data_set=scored.data_set)
    check_contradictions(record)
    failed = [replace(one, failure="its masks cannot be read") for one in record.results]
    results, data_set = discreet(failed, judged=True)
    check_contradictions(replace(record, results=tuple(results), data_set=data_set))


def test_the_union_that_is_told_is_that_of_the_score_that_is_told():
    """So that the estimate's author, who knows all else, learns nothing from it; and the mean stays that of all
    pixels."""
    rng = np.random.default_rng(3)
    made = []
    for k in range(40):
        truth, estimate = rng.integers(1000, 90_000, 2).tolist()
        both = min(truth, estimate) * rng.uniform(0.2, 0.95)
        union = truth + estimate - both
        metrics = {"iou": both / union, "union_px": union, "truth_px": truth, "estimate_px": estimate}
        made.append(ResultRecord(track="segmentation", split="s", sequence=str(k), method="m", metrics=metrics))
    seen, _ = discreet(made)
    for result, exact in zip(seen, made, strict=True):
        iou, truth = result.metrics["iou"], result.metrics["truth_px"]
        follows = (truth + exact.metrics["estimate_px"]) / (1.0 + iou)
        assert result.metrics["union_px"] == pytest.approx(follows, rel=0.006)
        assert result.metrics["union_px"] == pytest.approx(exact.metrics["union_px"], rel=0.07)
        assert digits(truth) <= 2

    def whole(results: list[ResultRecord]) -> float:
        weights = [result.metrics["union_px"] for result in results]
        return float(np.average([result.metrics["iou"] for result in results], weights=weights))

    assert whole(seen) == pytest.approx(whole(made), abs=0.005)


def of_pixels(estimate: float) -> ResultRecord:
    """Masks of so many pixels, 72 % of them right, where 10 000 are true."""
    both = 0.72 * estimate
    metrics = {"iou": both / (10_000 + estimate - both), "precision": 0.72, "recall": both / 10_000}
    pixels = {"estimate_px": estimate, "truth_px": 10_000.0, "union_px": 10_000 + estimate - both}
    return ResultRecord(track="segmentation", split="s", sequence="a", method="m", metrics=metrics | pixels)


def test_of_a_few_chosen_pixels_it_is_not_told_how_many_are_right():
    _, few = discreet([of_pixels(255.0)])
    assert few["means"]["precision"] is None
    assert few["means"]["recall"] == 0.018, "a share has three decimals, as three digits of a small one tell as much"
    assert NO_PRECISION in metrics_table([of_pixels(255.0)], "x", few).notes
    _, many = discreet([of_pixels(5000.0)], {"metrics": {"iou": 0.0123456}})
    assert (many["means"]["precision"], many["means"]["recall"]) == (0.72, 0.36)
    assert many["metrics"]["iou"] == 0.012
    assert NO_PRECISION not in metrics_table([of_pixels(5000.0)], "x", many).notes


def full_means(results):
    """Means over the split to three significant digits, whatever is small."""
    return {
        (-1, key): value and significant(value, 3)
        for key, value in means_over_sequences(results, ["precision"]).items()
    }


def test_outlines_cut_to_powers_of_two_do_not_come_back_in_binary():
    masks = reconstruction.Masks()
    start = masks.iou(np.ones_like(masks.true))
    assert masks.binary(full_means, 8) > start + 0.07, "as three significant digits told it"
    assert masks.binary(reconstruction.told, 8) == start
    assert masks.binary(reconstruction.told, 3, LEAST_ESTIMATE) < start + 0.05


def test_a_skill_far_below_chance_is_told_as_the_least():
    result = ResultRecord(track="steering", split="s", sequence="a", method="m", metrics={"skill": -7.3, "yaw_cost": 1})
    ((seen,), _) = discreet([result])
    assert seen.metrics == {"skill": -1.0}


def test_a_missing_value_keeps_no_reason_that_was_made_in_sight_of_the_truth():
    metrics = {"ap_mask": math.nan, "wall_s": 2.34567}
    result = ResultRecord(
        track="detection", split="s", sequence="a", method="m", metrics=metrics, reasons={"ap_mask": "3 oysters"}
    )
    ((seen,), _) = discreet([result])
    assert "oysters" not in seen.reasons["ap_mask"]
    assert seen.metrics["wall_s"] == 2.34567, "what a run costs says nothing of the truth"
    assert set(seen.metrics) == {"ap_mask", "wall_s"} <= {"ap_mask", *COSTS}


def test_our_own_results_on_a_hidden_split_are_published_as_coarsely(tmp_path):
    exact = {"paths": {"alternatives": {"online": {"ate_rmse_m": 0.123456789}}}, "health": {"lost": 0.987654321}}
    told = {"notes": ("corrected, the ATE would be 0.456789 m",), "info": exact}
    results = [replace(result, split="slam-test", **told) for result in record_made().results]
    failed = replace(results[0], failure="the true path is 7.654321 m long", metrics={"score": 0.0, "coverage": 0.0})
    results[0] = replace(failed, reasons={})
    write_results(tmp_path / "results.json", results)
    ((record, curves),) = records_of(tmp_path, Attribution("x", "baseline"))
    assert curves is None
    for result in record.results:
        assert set(result.metrics) <= BY_SEQUENCE["slam"] | set(COSTS)
        assert (result.notes, result.info.keys() - {"method", "run"}) == ((), set())
    whole = json.dumps([result.to_dict() for result in record.results])
    assert not [number for number in ("0.1234", "0.9876", "0.4567", "7.654") if number in whole]
    assert record.results[0].failure
    assert set(record.data_set) == {"method", "metrics", "means"}
    check_contradictions(record)


def of_own_split(tmp_path, hidden, name="reef-test"):
    write_results(
        tmp_path / "results.json",
        [replace(one, split=name, split_digest="ef" * 32, hidden=hidden) for one in record_made().results],
    )
    return tmp_path


def test_results_say_themselves_that_their_split_is_hidden(tmp_path):
    ((hidden, _),) = records_of(of_own_split(tmp_path, True), Attribution("x", "reported"))
    assert all(set(result.metrics) <= BY_SEQUENCE["slam"] | set(COSTS) for result in hidden.results)
    ((public, _),) = records_of(of_own_split(tmp_path, False), Attribution("x", "reported"))
    assert "ate_rmse_m" in public.results[0].metrics


def test_no_result_can_make_a_hidden_split_of_this_version_public(tmp_path):
    ((record, _),) = records_of(of_own_split(tmp_path, False, "slam-test"), Attribution("x", "reported"))
    assert "ate_rmse_m" not in record.results[0].metrics


def test_older_results_on_an_unknown_split_are_published_only_with_its_recipe(tmp_path):
    folder = of_own_split(tmp_path, None)
    with pytest.raises(ResultError, match=r"whether the split is hidden.*--split FILE\.toml") as raised:
        records_of(folder, Attribution("x", "reported"))
    assert "\n" not in str(raised.value)
    recipe = tmp_path / "reef.toml"
    mini = resources.files("oysterbench_datasets") / "splits" / "slam-mini.toml"
    recipe.write_text(mini.read_text().replace('name = "slam-mini"', 'name = "reef-test"\nhidden = true', 1))
    ((record, _),) = records_of(folder, Attribution("x", "reported"), recipe=str(recipe))
    assert "ate_rmse_m" not in record.results[0].metrics
    recipe.write_text(recipe.read_text().replace("reef-test", "other-test"))
    with pytest.raises(ResultError, match="expected results on other-test, the split of"):
        records_of(folder, Attribution("x", "reported"), recipe=str(recipe))


def test_a_record_without_the_key_hidden_keeps_its_bytes_and_one_with_it_comes_back():
    old = record_made()
    assert b'"hidden"' not in old.data
    assert Record.from_dict(old.to_dict()).digest == old.digest
    new = replace(old, results=tuple(replace(one, hidden=True) for one in old.results))
    assert [one.hidden for one in Record.from_dict(new.to_dict()).results] == [True] * len(new.results)


def test_a_hundred_submissions_learn_all_labels_from_full_numbers_and_few_from_what_is_told():
    steering = Steering()
    assert steering.attack(full, True, 2) > 0.95
    assert steering.attack(reconstruction.told, False, 2) < 0.35


@pytest.mark.slow
def test_masks_oysters_and_paths_do_not_come_back_from_what_is_told():
    found = reconstruction.figures()
    start, known, told = found["masks: IoU"]
    assert known > 0.95
    assert told < start + 0.1
    start, known, told = found["single oysters: IoU"]
    assert known > 0.95
    assert told < start + 0.1
    start, known, told = found["paths: RMSE, m"]
    assert known < 0.25 * start
    assert told > 0.75 * start
