"""Scores of policies that explore, held against loops written out and against torchmetrics."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from oysterbench.core.errors import LabelError
from oysterbench.evaluate.metrics import FAILED, find_metric
from oysterbench.evaluate.statistics import resample_counts
from oysterbench.evaluate.steering import Commands, Labels, labels, normalised_score, score_pictures, score_rollout
from oysterbench.evaluate.steering.dataset import best_constant, over_sequences, together
from oysterbench.evaluate.steering.metrics import PICTURES, ROLLOUTS
from oysterbench.evaluate.steering.rollouts import episodes, seen_so_far
from oysterbench.report.confusion import confusion_figure
from oysterbench.report.exploring import pictures_table, whole_of
from oysterbench.report.steering import PictureRun
from oysterbench.results.records import ResultRecord
from tests.helpers.exploring_made import PITCH, YAW, made_log, made_split

TASK: Any = made_split().steering
COST = {"wall_s", "cpu_s", "pictures_per_s"}


def made(n: int, seed: int = 0, good: float = 0.5) -> tuple[Labels, Commands]:
    """Labels of n pictures, and commands that are the expert's in some of them."""
    generator = np.random.default_rng(seed)
    action_values = generator.gamma(2.0, 5.0, (n, len(YAW), len(PITCH)))
    best = action_values.reshape(n, -1).argmax(axis=1)
    classes = np.column_stack(np.unravel_index(best, (len(YAW), len(PITCH)))).astype(np.int64)
    shares = [generator.dirichlet(np.ones(k), n) for k in (len(YAW), len(PITCH))]
    for axis, share in enumerate(shares):
        right = generator.random(n) < good
        share[right, classes[right, axis]] += 1.0
        share /= share.sum(axis=1, keepdims=True)
    commanded = np.column_stack([share.argmax(axis=1) for share in shares]).astype(np.int64)
    return Labels(classes, action_values, TASK), Commands(commanded, *shares)


@pytest.mark.parametrize("seed", range(4))
def test_every_score_of_pictures_is_what_a_loop_finds(seed):
    truth, commands = made(60, seed)
    metrics = score_pictures(truth, commands).metrics
    for axis, degrees, shares in (("yaw", YAW, commands.yaw_probability), ("pitch", PITCH, commands.pitch_probability)):
        k = ("yaw", "pitch").index(axis)
        right = near = cost = cost_deg = 0.0
        for i in range(60):
            true, own = int(truth.classes[i, k]), int(commands.classes[i, k])
            right += true == own
            near += abs(true - own) <= 1
            for c in range(len(degrees)):
                cost += shares[i, c] * abs(c - true)
                cost_deg += shares[i, c] * abs(degrees[c] - degrees[true])
        assert metrics[f"{axis}_accuracy"] == pytest.approx(right / 60)
        assert metrics[f"{axis}_within_one"] == pytest.approx(near / 60)
        assert metrics[f"{axis}_cost_classes"] == pytest.approx(cost / 60)
        assert metrics[f"{axis}_cost_deg"] == pytest.approx(cost_deg / 60)
        f1, recalls = [], []
        for c in range(len(degrees)):
            of_true = [i for i in range(60) if truth.classes[i, k] == c]
            of_own = [i for i in range(60) if commands.classes[i, k] == c]
            both = len(set(of_true) & set(of_own))
            if of_true:
                recalls.append(both / len(of_true))
            if of_true or of_own:
                f1.append(0.0 if not both else 2 / (len(of_own) / both + len(of_true) / both))
        assert metrics[f"{axis}_macro_f1"] == pytest.approx(sum(f1) / len(f1))
        assert metrics[f"{axis}_balanced_accuracy"] == pytest.approx(sum(recalls) / len(recalls))
    lost = [truth.action_values[i].max() - truth.action_values[i][tuple(commands.classes[i])] for i in range(60)]
    assert metrics["regret_oysters"] == pytest.approx(sum(lost) / 60)
    joint = sum(tuple(a) == tuple(b) for a, b in zip(truth.classes.tolist(), commands.classes.tolist(), strict=True))
    assert metrics["joint_accuracy"] == pytest.approx(joint / 60)
    drawn = [
        truth.action_values[i].max() - truth.action_values[i][y, p]
        for i in range(60)
        for y in range(7)
        for p in range(7)
    ]
    assert metrics["skill"] == pytest.approx(1 - sum(lost) / (sum(drawn) / 49))
    assert metrics["pictures"] == 60


def test_f1_balanced_accuracy_and_confusion_agree_with_torchmetrics():
    torch = pytest.importorskip("torch")
    functional = pytest.importorskip("torchmetrics.functional.classification")
    truth, commands = made(200, 11)
    score = score_pictures(truth, commands)
    for k, (axis, counts) in enumerate((("yaw", score.yaw), ("pitch", score.pitch))):
        own, true = torch.from_numpy(commands.classes[:, k]), torch.from_numpy(truth.classes[:, k])
        assert len(set(true.tolist())) == 7  # where a class is never true, torchmetrics counts it as missed
        f1 = functional.multiclass_f1_score(own, true, 7, average="macro")
        recall = functional.multiclass_accuracy(own, true, 7, average="macro")
        assert score.metrics[f"{axis}_macro_f1"] == pytest.approx(float(f1), abs=1e-6)
        assert score.metrics[f"{axis}_balanced_accuracy"] == pytest.approx(float(recall), abs=1e-6)
        assert (counts == functional.multiclass_confusion_matrix(own, true, 7).numpy()).all()


def test_a_class_that_nobody_names_is_left_out_and_one_that_only_one_names_counts_nothing():
    counts = labels.confusion(np.array([0, 0, 1]), np.array([0, 2, 1]), 7)
    assert labels.macro_f1(counts) == pytest.approx((2 / 3 + 1.0 + 0.0) / 3)  # class 2 is commanded, and never true
    assert labels.balanced_accuracy(counts) == pytest.approx((0.5 + 1.0) / 2)  # and so has no recall


def test_over_no_pictures_nothing_has_a_value_and_everything_a_reason():
    nothing = score_pictures(
        Labels(np.zeros((0, 2), np.int64), np.zeros((0, 7, 7)), TASK),
        Commands(np.zeros((0, 2), np.int64), np.zeros((0, 7)), np.zeros((0, 7))),
    )
    assert nothing.metrics["pictures"] == 0
    assert all(math.isnan(value) for key, value in nothing.metrics.items() if key != "pictures")
    assert set(nothing.reasons) == set(nothing.metrics) - {"pictures"}


def test_the_expert_has_a_skill_of_one_and_all_commands_together_one_of_none():
    truth, _ = made(30, 3)
    assert labels.skill(truth.action_values, truth.classes) == 1.0
    every = [labels.skill(truth.action_values, np.tile([y, p], (30, 1))) for y in range(7) for p in range(7)]
    assert np.mean(every) == pytest.approx(0.0, abs=1e-12)
    worst = truth.action_values.reshape(30, -1).argmin(axis=1)
    assert labels.skill(truth.action_values, np.column_stack(np.unravel_index(worst, (7, 7)))) < 0


def test_of_commands_that_are_worth_the_same_any_is_right():
    truth, _ = made(5, 4)
    action_values = truth.action_values.copy()
    action_values[:, 6, 6] = action_values.reshape(5, -1).max(axis=1)
    other = np.full((5, 2), 6)
    assert labels.skill(action_values, other) == 1.0
    alike = score_pictures(
        replace(truth, action_values=np.ones((5, 7, 7))),
        Commands(other, np.eye(7)[other[:, 0]], np.eye(7)[other[:, 1]]),
    )
    assert math.isnan(alike.metrics["skill"])
    assert alike.reasons["skill"] == "the command makes no difference in any image"
    assert alike.metrics["regret_oysters"] == 0


def test_a_miss_by_six_costs_six_times_a_miss_by_one():
    true = np.zeros(4, dtype=int)
    near, far = (labels.expected_cost(true, np.eye(7)[np.full(4, c)], np.arange(7.0)) for c in (1, 6))
    assert far == 6 * near == 6


@pytest.mark.parametrize(
    ("classes", "action_values", "message"),
    [
        ([[7, 0]], np.zeros((1, 7, 7)), "from 0 to 6"),
        ([[0, -1]], np.zeros((1, 7, 7)), "from 0 to 6"),
        ([[0, 0]], np.zeros((1, 7, 6)), "7 x 7"),
        ([[0, 0]], np.full((1, 7, 7), np.nan), "image 1"),
    ],
)
def test_labels_that_do_not_fit_the_task_are_refused(classes, action_values, message):
    with pytest.raises(LabelError, match=message):
        Labels(np.array(classes), action_values, TASK, "reef")


def test_several_sequences_together_are_scored_as_one_and_resampled_whole():
    parts = [made(8 + k, 20 + k) for k in range(7)]
    found = over_sequences(parts)
    assert found.score.metrics["pictures"] == sum(8 + k for k in range(7))
    counts = resample_counts(7)
    for row in (0, 17, 4321):  # a resample, its pictures laid out one after the other
        chosen = [part for part, n in zip(parts, counts[row], strict=True) for _ in range(int(n))]
        assert sum(counts[row]) == 7
        one = over_sequences(chosen).score.metrics
        assert one["skill"] == pytest.approx(1 - _ratio(parts, counts[row], labels.regrets, labels.chance_regrets))
    for key in ("skill", "regret_oysters", "yaw_accuracy", "yaw_macro_f1", "pitch_cost_deg"):
        interval = found.intervals[key]
        assert interval.low < found.score.metrics[key] < interval.high
    few = over_sequences(parts[:2])
    assert "2 sequences" in few.intervals["skill"].reason


def test_several_runs_on_a_sequence_are_resampled_with_it_and_its_images_counted_once():
    parts = [made(8 + k, 20 + k) for k in range(7)]
    once = over_sequences(parts)
    about = {"track": "steering", "split": "", "method": "m"}
    records = [ResultRecord(**about, sequence=f"{k}", run=run) for k in range(7) for run in range(3)]
    whole = whole_of([PictureRun(record, *parts[int(record.sequence)]) for record in records])["m"]
    assert (whole.sequences, whole.runs) == (7, [3] * 7)
    assert whole.score.metrics == pytest.approx(once.score.metrics)
    for key, interval in once.intervals.items():
        assert (whole.intervals[key].low, whole.intervals[key].high) == pytest.approx((interval.low, interval.high))
    lost = [record for record in records if (record.sequence, record.run) not in {("0", 1), ("3", 2), ("3", 0)}]
    uneven = whole_of([PictureRun(record, *parts[int(record.sequence)]) for record in lost])["m"]
    assert uneven.score.metrics == pytest.approx(once.score.metrics), "each sequence counts as often as any other"
    assert uneven.intervals["skill"].low == pytest.approx(once.intervals["skill"].low)
    few = whole_of([PictureRun(record, *parts[0]) for record in records[:6]])["m"]
    assert "2 sequences: no" in few.intervals["skill"].reason
    note = pictures_table({"m": few}, None, TASK).notes[0]
    assert note.startswith("16 images of 2 sequences together, in 3 runs on each; 2 sequences")
    lost = whole_of([PictureRun(record, *parts[0]) for record in records[:5]])["m"]
    assert lost.score.metrics["pictures"] == 16
    assert (
        "16 images of 2 sequences together, in 2 to 3 runs on each" in pictures_table({"m": lost}, None, TASK).notes[0]
    )
    killed = replace(records[0], method="killed")
    assert list(whole_of([PictureRun(record, *parts[0]) for record in [*records[:6], killed]])) == ["m"]


def _ratio(parts, counts, top, bottom) -> float:
    tops = sum(n * top(truth.action_values, made.classes).sum() for (truth, made), n in zip(parts, counts, strict=True))
    return tops / sum(n * bottom(truth.action_values).sum() for (truth, _), n in zip(parts, counts, strict=True))


def test_the_best_constant_answer_is_the_one_command_with_the_highest_mean_skill():
    """Each sequence has one vote, however many images it has; one where no command matters has none."""
    truths = [made(n, 60 + n)[0] for n in (4, 30, 9)]
    truths[1].action_values[:, 2, 3] += 8.0
    truths.append(Labels(truths[0].classes, np.ones_like(truths[0].action_values), TASK))
    means = {}
    for yaw in range(len(YAW)):
        for pitch in range(len(PITCH)):
            classes = [np.tile([yaw, pitch], (len(truth.classes), 1)) for truth in truths]
            skills = [labels.skill(t.action_values, c) for t, c in zip(truths, classes, strict=True)]
            means[yaw, pitch] = np.nanmean(skills)
    found = best_constant(truths)
    assert found is not None
    assert means[found.classes] == max(means.values()) == pytest.approx(found.skill)
    metrics = found.whole.score.metrics
    assert metrics["pictures"] == 4 + 30 + 9 + 4
    together = np.concatenate([truth.classes for truth in truths])
    assert metrics["yaw_accuracy"] == (together[:, 0] == found.classes[0]).mean()
    assert metrics["joint_accuracy"] == (together == found.classes).all(axis=1).mean()
    assert metrics["yaw_cost_deg"] == pytest.approx(
        np.abs(np.array(YAW)[together[:, 0]] - YAW[found.classes[0]]).mean()
    )
    assert best_constant(truths[-1:]) is None


def test_a_macro_f1_of_resamples_is_that_of_their_pictures():
    from oysterbench.evaluate.steering import dataset

    parts = [made(9, 40 + k) for k in range(6)]
    counts = resample_counts(6)[:5]
    fast = dataset._macro_f1(counts, [score_pictures(*part).yaw.astype(float) for part in parts])
    for row, value in zip(counts, fast, strict=True):
        chosen = [part for part, n in zip(parts, row, strict=True) for _ in range(int(n))]
        assert value == pytest.approx(over_sequences(chosen).score.metrics["yaw_macro_f1"])


def test_a_dive_is_measured_step_by_step():
    log = made_log("reef", "mine", 12, [2, 0, 3], oysters=50)
    contact, turned = np.zeros(13, bool), np.zeros(13, bool)
    contact[[2, 3, 7, 12]] = True
    turned[[5, 6]] = True
    altitude = np.full(13, 1.0)
    altitude[0], altitude[4], altitude[9] = 9.0, 0.49, 1.41
    metrics = score_rollout(replace(log, contact=contact, turned=turned, altitude=altitude), TASK).metrics
    assert metrics["oysters_per_min"] == 5 / (12 / 60)
    assert metrics["oysters_seen"] == 5
    assert metrics["found_share"] == 5 / 50
    assert metrics["covered_share"] == 0.5
    assert metrics["contacts"] == 3
    assert metrics["contacts_per_min"] == 15
    assert metrics["contact_share"] == 4 / 12
    assert metrics["in_band_share"] == 10 / 12  # the moment before the first command is nobody's
    assert metrics["turned_back"] == 1
    assert metrics["distance_m"] == pytest.approx(12 * 2 * math.sin(0.1))
    assert metrics["oysters_per_m"] == pytest.approx(5 / metrics["distance_m"])
    assert metrics["steps_per_s"] == 24
    assert (metrics["wall_s"], metrics["cpu_s"], metrics["rollout_s"]) == (0.5, 0.4, 12)
    time, seen = seen_so_far(log)
    assert time[-1] == 12
    assert seen[[0, 1, 2, 12]].tolist() == [2, 2, 5, 5]


def test_a_dive_without_commands_or_oysters_has_reasons_in_place_of_numbers():
    score = score_rollout(made_log("reef", "mine", 0, [0], oysters=0), TASK)
    for key in ("oysters_per_min", "found_share", "contacts_per_min", "in_band_share", "oysters_per_m", "steps_per_s"):
        if key != "steps_per_s":
            assert math.isnan(score.metrics[key])
            assert score.reasons[key]


@pytest.mark.parametrize(
    ("marked", "runs"), [([], 0), ([1], 1), ([0, 1, 1, 0, 1], 2), ([1, 1, 1], 1), ([0, 0], 0), ([1, 0, 1, 0], 2)]
)
def test_episodes_are_counted_once(marked, runs):
    assert episodes(np.array(marked, dtype=bool)) == runs


def test_a_place_is_the_ratio_of_mean_differences_with_the_interval_of_its_resamples():
    generator = np.random.default_rng(5)
    reefs = [f"r{k}" for k in range(10)]
    low = {name: [float(value)] for name, value in zip(reefs, generator.uniform(5, 15, 10), strict=True)}
    high = {name: [low[name][0] + float(gain)] for name, gain in zip(reefs, generator.uniform(5, 30, 10), strict=True)}
    own = {name: [low[name][0] + 0.4 * (high[name][0] - low[name][0])] for name in reefs}
    exact = normalised_score(own, low, high)
    assert exact.value == pytest.approx(0.4)
    assert exact.interval.low == pytest.approx(0.4)  # the same share on every reef is the same in every resample
    assert exact.interval.high == pytest.approx(0.4)
    assert normalised_score(low, low, high).value == 0
    assert normalised_score(high, low, high).value == 1
    noisy = {name: [value[0] + float(generator.normal(0, 2))] for name, value in own.items()}
    found = normalised_score(noisy, low, high)
    assert found.interval.low < found.value < found.interval.high
    assert found.interval.high - found.interval.low > 0.01
    chosen = np.random.default_rng(9).integers(0, 10, (2000, 10))
    tops = np.array([noisy[n][0] - low[n][0] for n in reefs])[chosen].mean(axis=1)
    gaps = np.array([high[n][0] - low[n][0] for n in reefs])[chosen].mean(axis=1)
    spread = np.quantile(tops / gaps, [0.025, 0.975])
    assert found.interval.low == pytest.approx(spread[0], abs=0.03)
    assert found.interval.high == pytest.approx(spread[1], abs=0.03)


def test_a_place_needs_reefs_in_common_and_an_upper_policy_that_is_above():
    one, two = {"a": [1.0]}, {"b": [2.0]}
    assert normalised_score(one, one, two).reason == "no reef in common"
    assert "not above" in normalised_score(one, one, one).reason
    alone = normalised_score({"a": [3.0]}, {"a": [1.0]}, {"a": [5.0]})
    assert alone.value == 0.5
    assert "1 reef:" in alone.interval.reason


def test_every_metric_is_defined_and_every_definition_measured():
    truth, commands = made(9)
    assert set(score_pictures(truth, commands).metrics) == set(PICTURES) - COST
    assert set(score_rollout(made_log("reef", "mine", 3, [1]), TASK).metrics) - COST == set(ROLLOUTS)
    for key, metric in {**PICTURES, **ROLLOUTS}.items():
        assert find_metric(key) is metric
        assert metric.heading
        assert metric.definition.endswith(".")
    assert find_metric("skill").better == find_metric("oysters_per_min").better == "higher"
    assert FAILED["steering"] == {"skill": 0.0}
    assert FAILED["exploration"] == {"oysters_per_min": 0.0}


def test_the_figure_of_confusions_says_in_how_many_runs_its_images_count():
    truth, commands = made(12)
    for runs, said in ((1, "images, by the expert's"), (3, "images, in each of 3 runs, by the expert's")):
        whole = over_sequences([together([(truth, commands)] * runs)], [runs])
        figure = confusion_figure("mine", whole.score, truth.task, whole.runs)
        (note,) = [text.get_text() for text in figure.texts if "Framed" in text.get_text()]
        assert f"{len(truth.classes)} {said}" in note
        assert ("of that class, in 3 runs together." in note) == (runs == 3)
