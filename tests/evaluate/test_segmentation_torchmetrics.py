"""Masks are scored as torchmetrics does, where its rules for what is empty are the same."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.streams import stream
from oysterbench.evaluate.segmentation import ClipScorer, EstimateImage, TruthImage
from oysterbench.recipe import CLASSES

torch = pytest.importorskip("torch")
classification = pytest.importorskip("torchmetrics.functional.classification")

IGNORED = -1


def test_binary_scores_over_a_data_set_agree():
    rng = stream(7, b"", "torchmetrics")
    scorer, targets, probabilities = ClipScorer(), [], []
    for k in range(12):
        true = rng.random((40, 50)) < rng.random()
        probability = np.clip(0.6 * true + 0.5 * rng.random((40, 50)), 0, 1).astype(np.float32)
        probability[np.abs(probability - 0.5) < 1e-3] = 0.6  # at 0.5 itself the two differ: >= here, > there
        ignore = rng.random((40, 50)) < 0.1
        classes = np.where(true, np.uint8(2), np.uint8(0))
        scorer.add(TruthImage(str(k), classes, False, ignore), EstimateImage(str(k), probability=probability))
        targets.append(np.where(ignore, IGNORED, true))
        probabilities.append(probability)
    predicted, true = torch.tensor(np.array(probabilities)), torch.tensor(np.array(targets)).long()
    metrics = scorer.result().metrics
    for key, name in (
        ("iou", "binary_jaccard_index"),
        ("dice", "binary_f1_score"),
        ("precision", "binary_precision"),
        ("recall", "binary_recall"),
    ):
        theirs = getattr(classification, name)(predicted, true, threshold=0.5, ignore_index=IGNORED)
        assert metrics[key] == pytest.approx(float(theirs), abs=1e-6), key


def test_scores_of_classes_agree():
    rng = stream(8, b"", "torchmetrics")
    true, predicted = rng.integers(0, len(CLASSES), (2, 3, 40, 50)).astype(np.uint8)
    scorer = ClipScorer()
    for k in range(3):
        scorer.add(TruthImage(str(k), true[k]), EstimateImage(str(k), classes=predicted[k]))
    pair = (torch.tensor(predicted).long(), torch.tensor(true).long())
    theirs = classification.multiclass_jaccard_index(*pair, num_classes=len(CLASSES), average=None)
    metrics = scorer.result().metrics
    assert [metrics[f"iou_{name}"] for name in CLASSES.values()] == pytest.approx(theirs.tolist(), abs=1e-6)
    mean = classification.multiclass_jaccard_index(*pair, num_classes=len(CLASSES), average="macro")
    assert metrics["miou"] == pytest.approx(float(mean), abs=1e-6)
