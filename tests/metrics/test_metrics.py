"""Metrics as functions: the evaluators' own numbers, those of independent programs, and plain Python floats."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench import metrics
from oysterbench.core.errors import LabelError, OptionError
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.evaluate.metrics import TRACKS

TRAJECTORIES = {
    "ate": "ate_rmse_m",
    "ate_rotation": "ate_rotation_rmse_deg",
    "rpe": "rpe_1s_translation_rmse_m",
    "rpe_rotation": "rpe_1s_rotation_rmse_deg",
    "drift": "subpath_translation_percent",
    "velocity_error": "velocity_rmse_m_per_s",
    "scale_error": "subpath_scale_error_percent",
    "coverage": "coverage",
    "trajectory_score": "score",
}
"""Function -> key of a result."""

ONE = np.ones((4, 4), dtype=int)
"""An oyster that fills its image."""


@pytest.fixture(scope="module")
def pair():
    generator = np.random.default_rng(5)
    t = np.arange(0, 12, 0.05)
    stamps = (1e9 * (100 + t)).astype(np.int64)
    positions = np.stack([2 * np.sin(0.5 * t), np.sin(t), -1 + 0.1 * t], axis=1)
    attitudes = Rotation.from_euler("zyx", np.stack([0.3 * t, 0.05 * np.sin(t), 0 * t], axis=1))
    truth = Trajectory(stamps, positions, attitudes.as_quat())
    turned = Rotation.from_rotvec(0.01 * generator.normal(size=(len(t), 3))) * attitudes
    shaken = positions + 0.02 * generator.normal(size=positions.shape)
    return truth, Trajectory(stamps[:200], shaken[:200], turned.as_quat()[:200])


@pytest.fixture(scope="module")
def masks():
    generator = np.random.default_rng(6)
    return generator.random((3, 40, 50)) < 0.3, generator.random((3, 40, 50)), generator.random((3, 40, 50)) < 0.1


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_a_metric_of_poses_is_that_of_the_evaluator(pair, name, tmp_path):
    value = getattr(metrics, name)(*pair, align="se3")
    assert value == oysterbench.score(*pair, align="se3").metrics[TRAJECTORIES[name]]
    assert type(value) is float
    write_tum(tmp_path / "a.tum", pair[0])
    write_tum(tmp_path / "b.tum", pair[1])
    assert getattr(metrics, name)(tmp_path / "a.tum", tmp_path / "b.tum", align="se3") == pytest.approx(value, abs=1e-5)


def test_the_error_of_positions_is_the_root_mean_square(pair):
    truth, estimate = pair
    off = estimate.positions - truth.positions[:200]
    assert metrics.ate(truth, estimate, align="none") == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.mark.parametrize(("delta", "unit"), [(2.0, "s"), (1.5, "m"), (20, "deg"), (7, "frames")])
def test_relative_errors_are_taken_over_what_is_asked_for(pair, delta, unit):
    key = "rpe_frames" if unit == "frames" else f"rpe_delta_{unit}"
    found = oysterbench.score(*pair, **{key: delta}).metrics
    assert metrics.rpe(*pair, delta, unit) == found[f"rpe_{delta:g}{unit}_translation_rmse_m"]
    assert metrics.rpe_rotation(*pair, delta, unit) == found[f"rpe_{delta:g}{unit}_rotation_rmse_deg"]


def test_what_has_no_sample_is_nan(pair):
    assert math.isnan(metrics.rpe(*pair, 1000, "m"))
    assert math.isnan(metrics.rpe(*pair, 1_000_000, "frames"))


@pytest.mark.parametrize("name", ["iou", "dice", "precision", "recall"])
def test_a_metric_of_masks_is_that_of_counted_pixels(masks, name):
    truth, probability, ignore = masks
    called, asked = probability >= 0.4, ~ignore
    hit, extra, missed = (int((part & asked).sum()) for part in (truth & called, ~truth & called, truth & ~called))
    wanted = {
        "iou": hit / (hit + extra + missed),
        "dice": 2 * hit / (2 * hit + extra + missed),
        "precision": hit / (hit + extra),
        "recall": hit / (hit + missed),
    }
    value = getattr(metrics, name)(truth, probability, ignore, threshold=0.4)
    assert value == pytest.approx(wanted[name])
    assert type(value) is float
    assert getattr(metrics, name)(list(truth), list(called), list(ignore)) == value, "of pictures one by one"


def test_tensors_are_masks_too(masks):
    torch = pytest.importorskip("torch")
    truth, probability, _ = masks
    assert metrics.iou(torch.from_numpy(truth), torch.from_numpy(probability)) == metrics.iou(truth, probability)
    assert metrics.iou(list(torch.from_numpy(truth)), probability) == metrics.iou(truth, probability)


def test_a_tensor_of_a_kind_that_numpy_has_not_is_refused_in_one_line(masks):
    torch = pytest.importorskip("torch")
    truth, probability, _ = masks
    with pytest.raises(LabelError, match=r"such as tensor.float\(\).cpu\(\).numpy\(\): .*BFloat16"):
        metrics.iou(truth, torch.from_numpy(probability).bfloat16())


def test_a_picture_has_one_vote_where_it_is_asked_for(masks):
    truth, probability, _ = masks
    each = [metrics.iou(one, other) for one, other in zip(truth, probability, strict=True)]
    assert metrics.image_iou(truth, probability) == pytest.approx(np.mean(each))
    assert metrics.boundary_iou(truth, truth) == 1.0


@pytest.mark.parametrize(
    ("ask", "pattern"),
    [
        (lambda: metrics.iou(np.ones((2, 4, 4), bool), np.ones((1, 4, 4), bool)), "as many estimated images"),
        (lambda: metrics.iou(np.ones((4, 4), bool), np.ones((4, 5), bool)), "expected an estimate of the truth's size"),
        (lambda: metrics.iou(np.full((4, 4), 7), np.ones((4, 4), bool)), "image 0: truth: expected a mask of bool"),
        (lambda: metrics.iou(np.ones((4, 4), bool), np.full((4, 4), 3.0)), "probabilities from 0 to 1, got 3 to 3"),
        (lambda: metrics.iou(np.ones(4, bool), np.ones(4, bool)), r"expected masks \(H, W\)"),
        (lambda: metrics.iou(np.ones((4, 4)) > 0, np.ones((4, 4)) > 0, np.ones((3, 3)) > 0), "ignore: expected"),
        (lambda: metrics.iou(ONE, ONE, [ONE < 1] * 2), "ignore: .* has, got more"),
        (lambda: metrics.iou(cast(Any, None), ONE), "expected masks .*, got None"),
        (lambda: metrics.average_precision(ONE, ONE, overlap=cast(Any, 60)), "overlap: expected 50 or 75"),
        (lambda: metrics.average_precision(ONE, ONE, overlap=cast(Any, 0.5)), "overlap: expected .* got 0.5"),
        (lambda: metrics.count_mae([1, 2], [1]), "as many estimated counts"),
        (lambda: metrics.average_precision(np.ones((4, 4), int), np.ones((2, 4, 4), int)), "of the same images"),
        (lambda: metrics.average_precision(np.ones((4, 4)), np.ones((4, 4), int)), "oyster numbers as integers"),
        (lambda: metrics.average_precision(np.ones((4, 4), int), np.ones((4, 4), int), [{2: 1.0}]), "no score of"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_one_line(ask, pattern):
    with pytest.raises(LabelError, match=pattern) as raised:
        ask()
    assert "\n" not in str(raised.value)


def test_options_that_there_are_not_are_refused(pair):
    with pytest.raises(OptionError, match="no setting 'alignment' of the evaluator; did you mean align"):
        metrics.ate(*pair, alignment="se3")
    with pytest.raises(OptionError, match="unit: expected one of s, m, deg, frames, got 'km'"):
        metrics.rpe(*pair, 1, "km")


@pytest.fixture
def oysters():
    """Two oysters, of which one is found, and something else that is none."""
    truth = np.zeros((60, 60), dtype=np.int64)
    truth[5:20, 5:20], truth[30:50, 30:45] = 1, 2
    estimate = np.where(truth == 2, 4, 0)
    estimate[40:55, 5:20] = 9
    return truth, estimate


@pytest.mark.parametrize("kind", ["mask", "box"])
def test_average_precision_is_that_of_101_recalls(oysters, kind):
    found = 51 / 101  # of the recalls 0, 0.01, ..., 1 those up to a half are reached
    assert metrics.average_precision(*oysters, [{4: 0.9, 9: 0.8}], kind) == pytest.approx(found)
    assert metrics.average_precision(*oysters, [{4: 0.7, 9: 0.8}], kind) == pytest.approx(found / 2), (
        "a wrong one first"
    )
    assert metrics.average_precision(*oysters, [{4: 0.7, 9: 0.8}], kind, overlap=75) == pytest.approx(found / 2)
    assert metrics.average_recall(*oysters, kind=kind) == 0.5


def test_numbers_may_be_as_large_as_an_int32_holds(oysters):
    """Those that panoptic tools compose of red, green and blue are."""
    true, said = oysters
    large = np.where(said > 0, np.iinfo(np.int32).max - 9 + said, 0).astype(np.int32)
    assert metrics.average_precision(true, large) == metrics.average_precision(true, said)


def test_panoptic_quality_is_overlaps_by_matches_and_half_of_what_has_none(oysters):
    assert metrics.panoptic_quality(*oysters) == pytest.approx(1.0 / (1 + 0.5 + 0.5))
    assert metrics.panoptic_quality(*(np.stack([one, one]) for one in oysters)) == pytest.approx(0.5)


def test_panoptic_quality_leaves_out_what_is_not_counted(oysters):
    true, _ = oysters
    scores = {int(one): 0.4 for one in np.unique(true) if one}
    assert metrics.panoptic_quality(true, true) == 1.0
    assert metrics.panoptic_quality(true, true, [scores | {1: 0.5}]) == pytest.approx(1 / (1 + 0.5 * (len(scores) - 1)))


def test_counts_are_held_against_each_other():
    assert metrics.count_mae([3, 5, 9], [4, 5, 4]) == 2.0
    assert metrics.count_bias([3, 5, 9], [4, 5, 4]) == pytest.approx(-4 / 3)
    assert metrics.count_rmse([3, 5, 9], [4, 5, 4]) == pytest.approx(math.sqrt(26 / 3))


def test_every_metric_of_every_track_is_listed():
    table = metrics.table()
    assert list(table.index) == [(track, key) for track, known in TRACKS.items() for key in known.metrics]
    assert (table["definition"] != "").all()
    assert set(metrics.table("steering").index.get_level_values("track")) == {"steering"}
    with pytest.raises(OptionError, match="track: expected one of slam"):
        metrics.table("sloam")


def test_every_function_says_what_it_takes_and_has_an_example():
    for name in metrics.__all__:
        function = getattr(metrics, name)
        assert function.__doc__, name
        if getattr(function, "__module__", "").startswith("oysterbench.metrics."):
            assert ">>> " in function.__doc__, name
