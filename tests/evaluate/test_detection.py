"""Single oysters are scored as pycocotools scores them, and as the table in `evaluate.detection` says where there is
nothing to score."""

from __future__ import annotations

import contextlib
import io
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from oysterbench.annotations import read_coco
from oysterbench.core.errors import LabelError
from oysterbench.core.streams import stream
from oysterbench.evaluate.detection import DetectionScorer, DetectionSettings, ImageInstances, Instance
from oysterbench.evaluate.detection.clip import over_clips
from oysterbench.evaluate.detection.instances import from_mask, from_planes, numpy_2
from oysterbench.evaluate.detection.matching import match
from oysterbench.evaluate.detection.panoptic import pair
from oysterbench.evaluate.detection.precision import PrecisionCurve, average_precision
from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.statistics import resample_counts, resampled_interval

NAN = math.nan
SIDE = 120


def square(x, y, size, score=NAN, crowd=False):
    """An oyster, square."""
    mask = np.zeros((SIDE, SIDE), bool)
    mask[y : y + size, x : x + size] = True
    return from_mask(mask, score, crowd)


def image(*instances, name="a", footprint_m2=None):
    """Oysters in a picture."""
    return ImageInstances(name, SIDE, SIDE, instances, footprint_m2)


def scored(*pairs, **options):
    """The result of images, (truth, estimate) each."""
    scorer = DetectionScorer(DetectionSettings(**options))
    for one in pairs:
        scorer.add(*one)
    return scorer.result()


def random_images(count, seed):
    """Oysters, estimates of them that are off, and some of nothing; a crowd region now and then."""
    rng = stream(seed, b"", "detection")
    pairs = []
    for k in range(count):
        true, predicted = [], []
        for _ in range(int(rng.integers(0, 7))):
            x, y, size = (int(v) for v in rng.integers((0, 0, 4), (70, 70, 50)))
            true.append(square(x, y, size, crowd=bool(rng.random() < 0.15)))
            if rng.random() < 0.8:
                dx, dy, more = (int(v) for v in rng.integers(-3, 4, 3))
                predicted.append(square(max(0, x + dx), max(0, y + dy), max(2, size + more), float(rng.random())))
        predicted += [square(*(int(v) for v in rng.integers(5, 60, 3)), float(rng.random())) for _ in range(2)]
        pairs.append((image(*true, name=str(k)), image(*predicted, name=str(k))))
    return pairs


def pycocotools_says(pairs, kind, most):
    """stats by COCOeval's own accumulation: precision (T, R, areas), recall (T, areas)."""
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    images = [{"id": k + 1, "width": SIDE, "height": SIDE} for k in range(len(pairs))]
    sides = []
    with contextlib.redirect_stdout(io.StringIO()), numpy_2():
        for side in (0, 1):
            rows = [
                {
                    "id": 0,
                    "image_id": k + 1,
                    "category_id": 1,
                    "bbox": list(one.box),
                    "area": one.area if side == 0 or kind == "segm" else one.box[2] * one.box[3],
                    "iscrowd": int(one.crowd),
                    "score": one.score,
                    "segmentation": one.mask,
                }
                for k, pair in enumerate(pairs)
                for one in pair[side].instances
            ]
            coco = COCO()
            coco.dataset = {
                "images": images,
                "categories": [{"id": 1}],
                "annotations": [{**row, "id": n + 1} for n, row in enumerate(rows)],
            }
            coco.createIndex()
            sides.append(coco)
        evaluation = COCOeval(*sides, kind)
        evaluation.params.maxDets = [1, 10, most]
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation.eval["precision"][:, :, 0, :, 2], evaluation.eval["recall"][:, 0, :, 2]


@pytest.mark.parametrize("seed", [1, 2])
def test_precision_and_recall_are_those_of_pycocotools(seed):
    pairs = random_images(12, seed)
    metrics = scored(*pairs).metrics
    for kind, name in (("segm", "mask"), ("bbox", "box")):
        precision, recall = pycocotools_says(pairs, kind, 300)
        theirs = {
            f"ap_{name}": precision[:, :, 0].mean(),
            f"ap50_{name}": precision[0, :, 0].mean(),
            f"ap75_{name}": precision[5, :, 0].mean(),
            f"ap_small_{name}": precision[:, :, 1].mean(),
            f"ap_medium_{name}": precision[:, :, 2].mean(),
            f"ar_{name}": recall[:, 0].mean(),
        }
        assert {key: metrics[key] for key in theirs} == pytest.approx(theirs, abs=1e-12)
        assert 0.05 < metrics[f"ap_{name}"] < 0.95  # neither trivially right nor wrong


def test_a_clip_taken_twice_is_the_clip_given_twice():
    pairs = random_images(6, 3)
    once, twice = (
        [match(*zip(*part, strict=True), "mask", 300)["all"] for part in parts]
        for parts in ((pairs[:3], pairs[3:]), (pairs[:3], pairs[3:], pairs[3:]))
    )
    weighed, _ = PrecisionCurve(once).at(np.array([1.0, 2.0]))
    repeated, _ = PrecisionCurve(twice).at()
    assert average_precision(weighed) == pytest.approx(average_precision(repeated), abs=1e-12)


# truth, estimate -> AP of masks, counted error, panoptic quality
CROWD = square(0, 0, 60, crowd=True)
PINNED = {
    "nothing at all": ((), (), NAN, 0, NAN),
    "an estimate of nothing": ((), (square(5, 5, 20, 0.9),), NAN, 1, 0.0),
    "missed": ((square(5, 5, 20),), (), 0.0, -1, 0.0),
    "found": ((square(5, 5, 20),), (square(5, 5, 20, 0.9),), 1.0, 0, 1.0),
    "found, but not counted": ((square(5, 5, 20),), (square(5, 5, 20, 0.4),), 1.0, -1, 0.0),
    "elsewhere": ((square(5, 5, 20),), (square(60, 60, 20, 0.9),), 0.0, 0, 0.0),
    "said twice": ((square(5, 5, 20),), (square(5, 5, 20, 0.9), square(5, 5, 20, 0.8)), 1.0, 1, 1.0),
    "only a crowd": ((CROWD,), (), NAN, 0, NAN),
    "on a crowd": ((CROWD,), (square(5, 5, 20, 0.9),), NAN, 0, NAN),
    "half on a crowd": ((CROWD, square(80, 80, 20)), (square(50, 5, 30, 0.9), square(80, 80, 20, 0.8)), 0.5, 1, 2 / 3),
}


@pytest.mark.parametrize("case", PINNED)
def test_what_is_empty_absent_or_ignored_has_a_pinned_answer(case):
    true, predicted, ap, error, quality = PINNED[case]
    result = scored((image(*true), image(*predicted)))
    metrics = result.metrics
    assert metrics["ap_mask"] == pytest.approx(ap, nan_ok=True)
    assert metrics["count_error"] == error
    assert metrics["pq"] == pytest.approx(quality, nan_ok=True)
    assert all(result.reasons[key] for key, value in metrics.items() if math.isnan(value))
    assert all(find_metric(key) is not None for key in metrics)


def test_more_than_a_hundred_oysters_are_asked_for():
    spots = [(x, y) for x in range(0, 120, 9) for y in range(0, 108, 9)][:150]
    pair = (image(*(square(*s, 8) for s in spots)), image(*(square(*s, 8, 0.9) for s in spots)))
    assert scored(pair).metrics["ap_mask"] == 1.0
    assert scored(pair, max_detections=100).metrics["ap_mask"] == pytest.approx(0.663, abs=1e-3)


def slow_panoptic(true, predicted, void):
    """Kirillov et al. 2019, equation 1, of sets of pixels."""
    matches = [
        (i, j, iou)
        for i, t in enumerate(true)
        for j, s in enumerate(predicted)
        if (iou := len(t & s) / len((t | s) - (void & s) | (t & s))) > 0.5
    ]
    extra = [j for j, s in enumerate(predicted) if j not in {m[1] for m in matches} and len(s & void) <= 0.5 * len(s)]
    missed = len(true) - len(matches)
    return sum(m[2] for m in matches), len(matches), len(extra), missed


@pytest.mark.parametrize("seed", range(5))
def test_panoptic_quality_agrees_with_sets_of_pixels(seed):
    rng = stream(seed, b"", "panoptic")
    coarse = rng.integers(0, 6, (8, 8)).astype(np.int32)
    true = np.kron(coarse, np.ones((5, 5), np.int32))
    predicted = np.where(rng.random(true.shape) < 0.25, rng.integers(0, 7, true.shape), true).astype(np.int32)
    void = (np.kron(rng.random((8, 8)) < 0.2, np.ones((5, 5))) > 0) & (true == 0)
    truth = from_planes("a", true, void)
    estimate = from_planes("a", predicted, scores=dict.fromkeys(range(7), 0.9))
    found = pair(truth, estimate, 0.5).counts
    planes = [{*np.flatnonzero(plane == k)} for plane in (true, predicted) for k in range(1, 7) if (plane == k).any()]
    n = len(np.unique(true[true > 0]))
    overlap, matched, extra, missed = slow_panoptic(planes[:n], planes[n:], {*np.flatnonzero(void)})
    assert (found.overlap, found.matched, found.extra, found.missed) == (
        pytest.approx(overlap),
        matched,
        extra,
        missed,
    )
    assert matched > 0


def test_counts_are_errors_by_image_and_by_square_metre():
    three, one = [square(x, 5, 9) for x in (0, 20, 40)], [square(0, 5, 9)]
    predicted = [[replace(o, score=0.9) for o in three[:1]], [replace(o, score=0.9) for o in three]]
    pairs = [
        (image(*three, name="a", footprint_m2=0.5), image(*predicted[0], name="a")),
        (image(*one, name="b", footprint_m2=1.5), image(*predicted[1], name="b")),
    ]
    metrics = scored(*pairs).metrics
    assert (metrics["count_mae"], metrics["count_rmse"], metrics["count_bias"]) == (2.0, 2.0, 0.0)
    assert metrics["density_error_per_m2"] == 0.0
    assert metrics["density_mae_per_m2"] == pytest.approx((2 / 0.5 + 2 / 1.5) / 2)
    assert metrics["density_truth_per_m2"] == 2.0
    unknown = scored((image(*three), image(*predicted[0])))
    assert "seabed" in unknown.reasons["density_error_per_m2"]


def test_counts_by_cells_do_not_let_errors_here_make_up_for_errors_there():
    """120 px: at level 1 cells of 60 px, at level 2 of 30 px, at level 3 of 15 px."""
    here, there = square(5, 5, 9), replace(square(100, 100, 9), score=0.9)
    near = replace(square(20, 5, 9), score=0.9)  # the same cell of 30 px, another one of 15 px
    found = {name: scored((image(here), image(one))).metrics for name, one in (("far", there), ("near", near))}
    assert [found["far"][key] for key in ("count_mae", "game_1", "game_2", "game_3")] == [0, 2, 2, 2]
    assert [found["near"][key] for key in ("count_mae", "game_1", "game_2", "game_3")] == [0, 0, 0, 2]
    for seed in range(5):
        metrics = scored(*random_images(4, seed)).metrics
        assert metrics["count_mae"] <= metrics["game_1"] <= metrics["game_2"] <= metrics["game_3"]


def test_a_detection_without_a_mask_has_a_box_and_overlaps_no_mask():
    """One box must not take a clip, whose masks are bad, out of the mean over clips."""
    truth, box = square(5, 5, 20), Instance((5.0, 5.0, 20.0, 20.0), None, 400.0, 0.9)
    result = scored((image(truth), image(box)))
    assert result.metrics["ap_box"] == pytest.approx(1.0)
    assert result.metrics["count_error"] == 0
    assert (result.metrics["ap_mask"], result.metrics["pq"]) == (0.0, 0.0)
    right, aside = replace(truth, score=0.8), replace(box, box=(60.0, 60.0, 9.0, 9.0))
    both = scored((image(truth), image(right, aside))).metrics
    wrong = scored((image(truth), image(right, replace(square(60, 60, 9), score=0.9)))).metrics
    assert both["ap_mask"] == wrong["ap_mask"] < 1.0


def test_where_the_ground_truth_has_no_masks_only_boxes_are_scored():
    truth = Instance((5.0, 5.0, 20.0, 20.0), None, 400.0)
    result = scored((image(truth), image(replace(square(5, 5, 20), score=0.9))))
    assert result.metrics["ap_box"] == pytest.approx(1.0)
    assert result.reasons["ap_mask"] == "the ground truth has boxes, and no masks"
    assert math.isnan(result.metrics["pq"])


def test_a_data_set_is_scored_at_once_and_its_interval_resamples_clips():
    clips = [scored(*random_images(4, seed)) for seed in range(10, 17)]
    whole, intervals = over_clips(clips)
    pairs = [pair for seed in range(10, 17) for pair in random_images(4, seed)]
    assert whole.metrics["ap_mask"] == pytest.approx(scored(*pairs).metrics["ap_mask"], abs=1e-12)
    assert intervals["ap_mask"].low < whole.metrics["ap_mask"] < intervals["ap_mask"].high
    assert over_clips(clips[:3])[1]["ap_mask"].reason.startswith("3 sequences")


def test_scores_that_are_no_numbers_and_other_sizes_are_refused():
    with pytest.raises(LabelError, match="a: instance 0: expected a score, got nan"):
        DetectionScorer().add(image(), image(square(5, 5, 20)))
    with pytest.raises(LabelError, match="truth's size, 120 x 120, got 4 x 3"):
        DetectionScorer().add(image(), ImageInstances("a", 3, 4, ()))


def states(truth, estimate):
    """Metrics of states of one picture: (x, live) of squares side by side."""
    true, said = (
        image(*(replace(square(x, 0, 10, score), live=live) for x, live in side))
        for side, score in ((truth, NAN), (estimate, 0.9))
    )
    return scored((true, said))


def test_each_state_is_a_class_and_the_states_of_what_was_found_are_scored():
    # Live: at 0 found, at 20 taken for dead, at 40 missed. Dead: at 60 found, at 80 taken for alive. At 100 there is
    # nothing.
    found = states(
        [(0, 1.0), (20, 1.0), (40, 1.0), (60, 0.0), (80, 0.0)],
        [(0, 0.9), (20, 0.1), (60, 0.4), (80, 0.5), (100, 0.8)],
    )
    assert found.metrics["f1_live"] == pytest.approx(2 * 1 / (3 + 3))
    assert found.metrics["f1_dead"] == pytest.approx(2 * 1 / (2 + 2))
    assert found.metrics["state_accuracy"] == pytest.approx((1 / 2 + 1 / 2) / 2)
    assert found.metrics["live_error"] == 0
    assert found.metrics["pq"] == pytest.approx(4 / (4 + 0.5 * 2))  # for which states do not matter


def test_who_calls_all_alive_has_the_accuracy_of_a_guess():
    found = states([(0, 1.0), (20, 1.0), (40, 0.0)], [(0, 1.0), (20, 1.0), (40, 1.0)])
    assert found.metrics["state_accuracy"] == 0.5
    assert found.metrics["f1_dead"] == 0
    assert found.metrics["live_error"] == 1


def test_oysters_of_unknown_state_are_in_no_metric_of_states():
    known = states([(0, 1.0), (20, 0.0)], [(0, 1.0), (20, 0.0)])
    more = states([(0, 1.0), (20, 0.0), (40, NAN)], [(0, 1.0), (20, 0.0), (40, 1.0)])
    assert more.states == known.states


def test_without_states_in_truth_or_estimate_there_is_a_reason():
    for truth, estimate, why in (((0, NAN), (0, 1.0), "truth"), ((0, 1.0), (0, NAN), "estimate")):
        found = states([truth], [estimate])
        for key in ("f1_live", "f1_dead", "state_accuracy", "live_error"):
            assert math.isnan(found.metrics[key])
            assert found.reasons[key] == f"the {why} does not tell live oysters from dead ones"


def test_states_of_a_clip_are_those_of_its_pictures_together():
    one = (image(replace(square(0, 0, 10), live=1.0)), image(replace(square(0, 0, 10, 0.9), live=1.0)))
    other = (image(replace(square(0, 0, 10), live=0.0)), image(replace(square(0, 0, 10, 0.9), live=1.0)))
    whole, _ = over_clips([scored(one), scored(other)])
    assert whole.metrics["state_accuracy"] == 0.5
    assert whole.metrics["f1_live"] == pytest.approx(2 / 3)


def test_counts_and_panoptic_quality_have_intervals_over_clips():
    clips = []
    for k in range(8):  # of clip k, k of 10 oysters are missed in one image and none in the other
        true = [square(10 * (n % 5), 10 * (n // 5), 8) for n in range(10)]
        found = [replace(one, score=0.9) for one in true]
        clips.append(scored((image(*true, name="a"), image(*found[k:], name="a")), (image(name="b"), image(name="b"))))
    whole, intervals = over_clips(clips)
    assert whole.metrics["count_bias"] == pytest.approx(-28 / 16)
    for key in ("count_bias", "count_mae", "pq"):
        assert intervals[key].low < whole.metrics[key] < intervals[key].high
    assert intervals["count_mae"].low == pytest.approx(-intervals["count_bias"].high)
    drawn = resample_counts(8)
    values = -(drawn @ np.arange(8)) / (2 * drawn.sum(axis=1))
    assert intervals["count_bias"].low == pytest.approx(resampled_interval(values, 8).low)
    assert not over_clips(clips[:3])[1]["count_bias"].known


def test_ignored_oysters_excuse_no_boxes_between_them(tmp_path):
    """All of them are one crowd region, whose bounding box is the whole image: false boxes were neither right nor wrong
    wherever they were. So it is of a COCO file."""
    numbers, ignore = np.zeros((SIDE, SIDE), np.int32), np.zeros((SIDE, SIDE), bool)
    numbers[50:70, 50:70] = 1
    ignore[:12, :12] = ignore[-12:, -12:] = True
    truth = from_planes("a", numbers, ignore)
    right, false = square(50, 50, 20, 0.6), [square(x, 75, 10, 0.9) for x in range(10, 100, 12)]
    on_ignored = square(1, 1, 10, 0.9)
    found = scored((truth, image(right, *false, on_ignored)))
    assert found.metrics["ap50_box"] == found.metrics["ap50_mask"] == pytest.approx(1 / (1 + len(false)), abs=1e-3)
    boxes = [replace(one, mask=None) for one in (right, *false, on_ignored)]
    counted = scored((truth, image(*boxes)))
    assert counted.metrics["ap50_box"] == found.metrics["ap50_box"]
    assert counted.metrics["count_estimate"] == found.metrics["count_estimate"] == 1 + len(false)
    regions = [(numbers == 1, 0), (ignore, 1)]
    annotations = [annotation(k, mask, iscrowd) for k, (mask, iscrowd) in enumerate(regions)]
    content = {"images": [{"id": 1, "file_name": "a.png", "width": SIDE, "height": SIDE}], "annotations": annotations}
    (tmp_path / "a.json").write_text(json.dumps({**content, "categories": [{"id": 1, "name": "oyster"}]}))
    read = read_coco(tmp_path / "a.json").instances("a", scored=False)
    assert scored((read, image(right, *false, on_ignored))).metrics == pytest.approx(found.metrics, nan_ok=True)
    assert scored((read, image(*boxes))).metrics == pytest.approx(counted.metrics, nan_ok=True)


def annotation(number: int, mask: np.ndarray, iscrowd: int) -> dict[str, Any]:
    """A COCO annotation, with a mask of run lengths and the box around it."""
    one = from_mask(mask)
    assert one.mask is not None
    runs = {**one.mask, "counts": one.mask["counts"].decode()}
    about = {"id": number, "image_id": 1, "category_id": 1, "iscrowd": iscrowd}
    return {**about, "segmentation": runs, "bbox": list(one.box), "area": one.area}
