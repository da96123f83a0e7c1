"""Masks are scored as a slow count of pixels, and as the table in `evaluate.segmentation` says where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from oysterbench.core.errors import LabelError
from oysterbench.core.streams import stream
from oysterbench.evaluate.detection.instances import from_mask
from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.segmentation import SEGMENTATION, ClipScorer, EstimateImage, SegmentationSettings, TruthImage
from oysterbench.evaluate.segmentation.boundary import boundary_depth, inner_boundary
from oysterbench.evaluate.segmentation.clip import join
from oysterbench.evaluate.segmentation.dataset import over_dataset
from oysterbench.evaluate.segmentation.images import check_size
from oysterbench.evaluate.segmentation.settings import class_names
from oysterbench.evaluate.segmentation.thresholds import STEPS
from oysterbench.recipe import CLASSES, OYSTER
from tests.helpers.masks import border, counted, pictures, truth_of

EMPTY, FULL = np.zeros((4, 4), bool), np.ones((4, 4), bool)
LEFT = np.tile([True, True, False, False], (4, 1))
CORNER = np.zeros((4, 4), bool)
CORNER[0, 0] = True
NAN = math.nan


def scored(*pairs, **options):
    """The result of masks, each (truth, estimate) or (truth, estimate, ignored)."""
    scorer = ClipScorer(SegmentationSettings(**options))
    for k, (true, predicted, *ignore) in enumerate(pairs):
        scorer.add(truth_of(true, *ignore, name=str(k)), EstimateImage(str(k), oyster=predicted))
    return scorer.result()


# truth, estimate, ignored -> IoU of the image; over the data set: IoU, precision, recall; rate of false positives on
# empty images; hits, extras, misses
PINNED = {
    "both empty": (EMPTY, EMPTY, None, 1.0, (1.0, NAN, NAN), 0.0, (0, 0, 0)),
    "false positives on an empty image": (EMPTY, LEFT, None, 0.0, (0.0, 0.0, NAN), 0.5, (0, 8, 0)),
    "all missed": (LEFT, EMPTY, None, 0.0, (0.0, NAN, 0.0), NAN, (0, 0, 8)),
    "elsewhere": (LEFT, ~LEFT, None, 0.0, (0.0, 0.0, 0.0), NAN, (0, 8, 8)),
    "all right": (LEFT, LEFT, None, 1.0, (1.0, 1.0, 1.0), NAN, (8, 0, 0)),
    "everything is oyster, and called so": (FULL, FULL, None, 1.0, (1.0, 1.0, 1.0), NAN, (16, 0, 0)),
    "half": (LEFT, FULL, None, 0.5, (0.5, 0.5, 1.0), NAN, (8, 8, 0)),
    "errors are ignored": (LEFT, FULL, ~LEFT, 1.0, (1.0, 1.0, 1.0), NAN, (8, 0, 0)),
    "the oysters are ignored": (LEFT, EMPTY, LEFT, 1.0, (1.0, NAN, NAN), 0.0, (0, 0, 0)),
    "false positives where the oysters are ignored": (LEFT, ~LEFT, LEFT, 0.0, (0.0, 0.0, NAN), 1.0, (0, 8, 0)),
    "all ignored": (LEFT, ~LEFT, FULL, NAN, (1.0, NAN, NAN), NAN, (0, 0, 0)),
}


@pytest.mark.parametrize("case", PINNED)
def test_what_is_empty_absent_or_ignored_has_a_pinned_answer(case):
    true, predicted, ignore, iou, over, empty_rate, counts = PINNED[case]
    result = scored((true, predicted, ignore))
    metrics = result.metrics
    assert result.images[0].metrics["iou"] == pytest.approx(iou, nan_ok=True)
    assert [metrics[key] for key in ("iou", "precision", "recall")] == pytest.approx(list(over), nan_ok=True)
    assert metrics["empty_false_positive_rate"] == pytest.approx(empty_rate, nan_ok=True)
    assert metrics["image_iou"] == pytest.approx(iou, nan_ok=True)
    names = ("true_positive_px", "false_positive_px", "false_negative_px")
    assert tuple(result.tally[name] for name in names) == counts
    assert all(result.reasons[key] for key, value in metrics.items() if math.isnan(value))


@settings(max_examples=25, deadline=None)
@given(st.lists(pictures(), min_size=1, max_size=4))
def test_counts_agree_with_a_slow_reference_on_random_masks(images):
    result = scored(*images)
    each = [counted(true, predicted, ignored) for true, predicted, ignored in images]
    hit, extra, missed, rest = (sum(column) for column in zip(*each, strict=True))
    union = hit + extra + missed
    metrics = result.metrics
    assert metrics["iou"] == pytest.approx(hit / union if union else 1.0)
    assert metrics["dice"] == pytest.approx(2 * hit / (2 * hit + extra + missed) if union else 1.0)
    assert metrics["precision"] == pytest.approx(hit / (hit + extra) if hit + extra else NAN, nan_ok=True)
    assert metrics["recall"] == pytest.approx(hit / (hit + missed) if hit + missed else NAN, nan_ok=True)
    asked = [image for image in each if sum(image)]
    mean = [h / (h + e + m) if h + e + m else 1.0 for h, e, m, _ in asked]
    assert metrics["image_iou"] == pytest.approx(sum(mean) / len(mean) if mean else NAN, nan_ok=True)
    empty = [(e, sum((h, e, m, r))) for h, e, m, r in asked if h + m == 0]
    rate = sum(e for e, _ in empty) / sum(n for _, n in empty) if empty else NAN
    assert metrics["empty_false_positive_rate"] == pytest.approx(rate, nan_ok=True)
    assert metrics["cover_error"] == pytest.approx((extra - missed) / (union + rest) if asked else NAN, nan_ok=True)


@settings(max_examples=15, deadline=None)
@given(pictures(), st.integers(1, 2))
def test_borders_agree_with_a_search_around_every_pixel(images, depth):
    true, predicted, ignored = images
    assert np.array_equal(inner_boundary(true, depth), border(true, depth))
    share = depth / math.hypot(*true.shape)
    assert boundary_depth(true.shape, share) == depth
    a, b = border(true, depth) & ~ignored, border(predicted, depth) & ~ignored
    union = int((a | b).sum())
    found = scored(images, boundary_share=share).metrics["boundary_iou"]
    assert found == pytest.approx(int((a & b).sum()) / union if union else 1.0)


def test_a_border_is_2_percent_of_the_diagonal_deep_and_one_pixel_at_least():
    assert boundary_depth((480, 640), 0.02) == 16
    assert boundary_depth((10, 10), 0.02) == 1


def test_masking_by_the_truth_before_scoring_would_hide_every_false_positive():
    honest, masked = scored((LEFT, FULL)), scored((LEFT, FULL & LEFT))
    assert masked.metrics["iou"] == 1.0
    assert honest.metrics["iou"] == 0.5


def test_the_data_set_and_its_images_are_two_numbers():
    big = np.ones((90, 100), bool)
    pairs = [(big, big), (np.pad(CORNER, ((0, 86), (0, 96))), np.zeros((90, 100), bool))]
    metrics = scored(*pairs).metrics
    assert metrics["iou"] == pytest.approx(9000 / 9001)
    assert metrics["image_iou"] == 0.5


def test_classes_agree_with_sets_of_pixels_and_absent_ones_have_no_part_in_the_mean():
    rng = stream(3, b"", "classes")
    true, predicted = rng.integers(0, 5, (2, 30, 40)).astype(np.uint8)
    ignore = rng.random((30, 40)) < 0.2
    scorer = ClipScorer()
    scorer.add(TruthImage("a", true, ignore=ignore), EstimateImage("a", classes=predicted))
    metrics, reasons = scorer.result().metrics, scorer.result().reasons
    each = []
    for number, name in CLASSES.items():
        a, b = (set(np.flatnonzero((plane == number) & ~ignore)) for plane in (true, predicted))
        value = len(a & b) / len(a | b) if a | b else NAN
        each.append(value)
        assert metrics[f"iou_{name}"] == pytest.approx(value, nan_ok=True)
    assert metrics["miou"] == pytest.approx(np.nanmean(each))
    assert metrics["iou"] == metrics["iou_oyster"]
    assert reasons["iou_vehicle"] == "neither ground truth nor estimate has it"


def test_the_mean_of_an_iou_weighted_as_stated_is_that_of_the_data_set():
    rng = stream(3, b"", "weighed")
    sequences = []
    for size in ((60, 100), (10, 20)):
        image = TruthImage("a", rng.integers(0, 3, size).astype(np.uint8))
        scorer = ClipScorer()
        scorer.add(image, EstimateImage("a", classes=np.where(rng.random(size) < size[0] / 70, image.classes, 1)))
        sequences.append(scorer.result())
    whole = join(sequences).metrics
    for key in ("iou", *(f"iou_{name}" for name in CLASSES.values())):
        values = np.array([one.metrics[key] for one in sequences])
        pixels = np.array([one.metrics[find_metric(key, "segmentation").weight] for one in sequences])
        mean = np.nansum(values * pixels) / pixels.sum() if pixels.any() else NAN
        assert mean == pytest.approx(whole[key], nan_ok=True)


def test_without_named_classes_there_is_no_mean_over_them():
    assert "miou" not in scored((LEFT, FULL)).metrics


def test_range_and_size_divide_the_pixels_of_the_truth():
    true = np.zeros((4, 6), bool)
    true[:, :3] = True
    predicted = np.zeros((4, 6), bool)
    predicted[:2] = True
    instances = np.zeros((4, 6), np.uint16)
    instances[:, :2], instances[:, 2] = 3, 1
    known = {
        "depth_m": np.where(np.arange(6) < 3, 0.5, 1.0).astype(np.float32) * np.ones((4, 1), np.float32),
        "instances": np.where(true, instances, 0).astype(np.uint16),
        "heights_mm": np.array([NAN, 50.0, NAN, 100.0]),
    }
    scorer = ClipScorer(SegmentationSettings(range_m=(0.7,), height_mm=(80.0,), area_px=(5.0,)))
    scorer.add(truth_of(true, **known), EstimateImage("a", oyster=predicted))
    metrics = scorer.result().metrics
    assert metrics["iou_range_below_0.7m"] == 0.5
    assert metrics["iou_range_from_0.7m"] == 0.0
    assert metrics["recall_height_below_80mm"] == 0.5
    assert metrics["weight_recall_height_below_80mm_px"] == 4
    assert metrics["weight_recall_area_from_5px_px"] == 8
    assert find_metric("recall_height_below_80mm").heading == "Recall, below 80 mm"
    assert class_names((1.0, 2.0), "m") == ["below_1m", "1to2m", "from_2m"]


@settings(max_examples=15, deadline=None)
@given(arrays(np.uint8, (6, 7)), arrays(bool, (6, 7)), st.integers(1, STEPS - 1))
def test_the_curve_is_the_score_at_every_threshold(levels, true, k):
    probability = levels.astype(np.float32) / np.float32(255)
    scorer = ClipScorer(SegmentationSettings(threshold=k / STEPS))
    scorer.add(truth_of(true), EstimateImage("a", probability=probability))
    result = scorer.result()
    assert result.curve.iou[k] == pytest.approx(result.metrics["iou"])
    assert result.curve.precision[k] == pytest.approx(result.metrics["precision"], nan_ok=True)
    assert result.curve.recall[k] == pytest.approx(result.metrics["recall"], nan_ok=True)
    assert result.metrics["best_iou"] == pytest.approx(result.curve.iou.max())


def test_the_best_iou_is_no_less_than_that_at_a_threshold_between_those_of_the_curve():
    scorer = ClipScorer(SegmentationSettings(threshold=0.4))
    probability = np.full((4, 4), 0.3995, dtype=np.float32)
    probability[:2] = 0.4005
    scorer.add(truth_of(probability > 0.4), EstimateImage("a", probability=probability))
    metrics = scorer.result().metrics
    assert (metrics["iou"], metrics["best_iou"], metrics["best_threshold"]) == (1.0, 1.0, 0.4)


def test_a_data_set_is_its_counts_together_and_its_interval_resamples_clips():
    rng = stream(5, b"", "clips")
    clips = []
    for _ in range(8):
        true = rng.random((5, 20, 20)) < rng.random()
        clips.append(scored(*((t, t ^ (rng.random((20, 20)) < 0.2)) for t in true)))
    found = over_dataset(clips)
    hits = sum(clip.tally["true_positive_px"] for clip in clips)
    union = sum(clip.metrics["union_px"] for clip in clips)
    assert found.whole.metrics["iou"] == pytest.approx(hits / union)
    assert found.whole.metrics["images"] == 40
    interval = found.intervals["iou"]
    assert interval.low < found.whole.metrics["iou"] < interval.high
    # Frames of one clip are no independent evidence: the same frames as clips of their own have a narrower interval.
    frames = over_dataset([clip for clip in clips for _ in range(5)])
    assert frames.intervals["iou"].high - frames.intervals["iou"].low < interval.high - interval.low


def test_few_clips_have_no_interval_and_the_reason_is_said():
    found = over_dataset([scored((LEFT, FULL))] * 3)
    assert found.intervals["iou"].reason == "3 sequences: no 95% interval is possible with fewer than 6"


def test_scoring_in_parts_and_at_once_are_the_same():
    parts = [scored((LEFT, FULL)), scored((EMPTY, LEFT))]
    assert join(parts).metrics == pytest.approx(scored((LEFT, FULL), (EMPTY, LEFT)).metrics, nan_ok=True)


@pytest.mark.parametrize(
    ("truth", "estimate", "message"),
    [
        (truth_of(LEFT), EstimateImage("b", oyster=LEFT), "estimate of image a, got that of b"),
        (truth_of(LEFT), EstimateImage("a", oyster=np.zeros((2, 3), bool)), "truth's size, 4 x 4, got 3 x 2"),
    ],
)
def test_estimates_of_other_images_and_sizes_are_refused(truth, estimate, message):
    with pytest.raises(LabelError, match=message):
        ClipScorer().add(truth, estimate)


def test_an_estimate_that_is_transposed_is_not_advised_to_be_resized():
    with pytest.raises(LabelError, match=r"expected .* 3 x 2, got 2 x 3; is it turned or transposed"):
        check_size(EstimateImage("a", oyster=np.zeros((3, 2), bool)), (2, 3), "a")


@pytest.mark.parametrize(
    ("given_as", "advice"),
    [
        ({"oyster": np.zeros((2, 3), bool)}, "resize masks to it by nearest neighbour"),
        ({"classes": np.zeros((2, 3), np.uint8)}, "resize classes to it by nearest neighbour"),
        ({"probability": np.array([[0, 1, 1], [0, 0, 1]], np.float32)}, "resize masks to it by nearest neighbour"),
        ({"probability": np.full((2, 3), 0.3, np.float32)}, r"resize probabilities to it \(bilinear\)"),
    ],
)
def test_an_estimate_of_another_size_is_told_how_to_resize_what_it_is(given_as, advice):
    with pytest.raises(LabelError, match=f"^mine/a.png: expected .* got 3 x 2; {advice}"):
        check_size(EstimateImage("a", **given_as), (4, 4), "mine/a.png")


@pytest.mark.parametrize(
    ("given_as", "message"),
    [
        ({"probability": np.full((2, 2), 1.5, np.float32)}, "probabilities from 0 to 1, got 1.5 to 1.5"),
        ({"probability": np.full((2, 2), NAN, np.float32)}, "probabilities from 0 to 1, got nan to nan"),
        ({"classes": np.full((2, 2), 99, np.uint8)}, "unknown class 99; known classes: 0 water"),
        ({"oyster": np.zeros((2, 2, 3), bool)}, r"an array \(H, W\), got one of shape \(2, 2, 3\)"),
        ({}, "one of oyster, probability and classes, got 0"),
    ],
)
def test_bad_answers_are_refused_by_name(given_as, message):
    with pytest.raises(LabelError, match=f"reef-7: .*{message}"):
        EstimateImage("reef-7", **given_as)


def test_settings_out_of_range_are_refused():
    for bad in ({"threshold": 0.0}, {"boundary_share": 0.7}, {"range_m": (2.0, 1.0)}):
        with pytest.raises(LabelError, match=f"evaluator setting '{next(iter(bad))}'"):
            SegmentationSettings(**bad)


def test_every_metric_is_defined():
    known = {"instances": np.ones((4, 4), np.uint16), "depth_m": np.ones((4, 4), np.float32)}
    scorer = ClipScorer()
    scorer.add(truth_of(LEFT, **known, heights_mm=np.array([NAN, 70.0])), EstimateImage("a", oyster=FULL))
    metrics = scorer.result().metrics
    assert all(find_metric(key) is not None for key in metrics)
    assert all(metric.weight in metrics for key, metric in SEGMENTATION.items() if metric.weight)


def test_bytes_that_no_bool_has_count_as_true_and_nothing_else(tmp_path):
    forged = np.where(LEFT, np.uint8(0), np.uint8(3)).view(bool)  # 2 * truth + 3 is a hit where there is none
    np.save(tmp_path / "a.npy", forged)
    kept = np.load(tmp_path / "a.npy")
    assert kept.view(np.uint8).max() == 3
    for mask in (forged, kept, kept.T.copy().T):
        assert scored((LEFT, mask)).tally == scored((LEFT, ~LEFT)).tally
        assert repr(from_mask(mask)) == repr(from_mask(~LEFT))  # not equal from Python 3.13 on, as NaNs differ


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"oyster": LEFT.astype(np.uint8) * 3},
            "expected a mask of bool, or of the integers 0 and 1, got uint8",
        ),
        ({"oyster": LEFT.astype(float)}, "expected a mask of bool, or of the integers 0 and 1, got float64"),
        ({"oyster": LEFT.astype(str)}, "expected a mask of bool, or of the integers 0 and 1, got <U5"),
        ({"classes": LEFT.astype(float)}, "expected class numbers as integers, got float64"),
        ({"probability": LEFT.astype(int)}, "expected probabilities as floating point numbers, got int64"),
    ],
)
def test_arrays_of_other_types_are_refused(given, message):
    with pytest.raises(LabelError, match=f"a: {message}"):
        EstimateImage("a", **given)


def test_masks_and_classes_of_any_integers_are_counted_alike():
    assert scored((LEFT, LEFT.astype(np.int64))).metrics["iou"] == 1.0
    scorer = ClipScorer()
    classes = np.where(LEFT, OYSTER, 0).astype(np.uint64)
    scorer.add(TruthImage("a", np.where(LEFT, OYSTER, 0).astype(np.uint8)), EstimateImage("a", classes=classes))
    assert scorer.result().metrics["iou"] == 1.0
