"""Commands of a policy against an expert's, image by image: ordered classes, and the cost of a wrong one.

Pure functions over arrays of N images. Classes are numbers from 0 to C - 1 in the order of the recipe, so that
neighbours are similar; action_values (N, Y, P) are what the expert's best plan would gain, in oysters, if it started
with class y of yaw and p of pitch.

Empty cases: without any image, all values are NaN. A class that is neither true nor commanded in any image is left out
of macro F1; one that is commanded but never true, or true but never commanded, counts 0. A class that is never true has
no recall, and is left out of the balanced accuracy.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array

Classes = NDArray[np.integer]
"""Class numbers (N,)."""


def accuracy(truth: Classes, commanded: Classes) -> float:
    """Share of the images whose class is the expert's."""
    return _mean(truth == commanded)


def within_one(truth: Classes, commanded: Classes) -> float:
    """Share of the images whose class is the expert's or adjacent to it."""
    return _mean(np.abs(truth - commanded) <= 1)


def joint_accuracy(truth: Classes, commanded: Classes) -> float:
    """Share of the images in which the classes (N, 2) of both axes are the expert's."""
    return _mean((truth == commanded).all(axis=1))


def confusion(truth: Classes, commanded: Classes, classes: int) -> NDArray[np.int64]:
    """Confusion matrix (C, C): number of images by the expert's class (row) and the commanded one (column)."""
    counts = np.bincount(truth * classes + commanded, minlength=classes * classes)
    return counts.reshape(classes, classes).astype(np.int64)


def balanced_accuracy(counts: NDArray[np.int64]) -> float:
    """Mean recall over the classes that are true in some image; counts (C, C): see `confusion`."""
    true = counts.sum(axis=1)
    known = true > 0
    return _mean(np.diag(counts)[known] / true[known])


def macro_f1(counts: NDArray[np.int64]) -> float:
    """Mean of F1 = 2 TP / (2 TP + FP + FN) over the classes that are true or commanded in some image."""
    met = counts.sum(axis=0) + counts.sum(axis=1)  # 2 TP + FP + FN
    known = met > 0
    return _mean(2 * np.diag(counts)[known] / met[known])


def expected_cost(truth: Classes, probability: Array, turns: Array) -> float:
    """Mean over images of sum_c p_c |t_c - t_truth|, in the unit of t.

    probability (N, C): of each class, adding up to 1; one-hot if a policy only names a class. turns (C,): those of the
    classes, in degrees, or the class numbers for a cost in classes.
    """
    off = np.abs(turns[None, :] - turns[truth][:, None])
    return _mean((probability * off).sum(axis=1))


def regrets(action_values: Array, commanded: Classes) -> Array:
    """Regret (N,) of each command (N, 2): what it loses against the best one, in oysters, at least 0."""
    best: Array = action_values.max(axis=(1, 2))
    return best - action_values[np.arange(len(action_values)), commanded[:, 0], commanded[:, 1]]


def chance_regrets(action_values: Array) -> Array:
    """Mean regret (N,) of a command drawn uniformly from all pairs of classes."""
    return np.asarray(action_values.max(axis=(1, 2)) - action_values.mean(axis=(1, 2)))


def skill(action_values: Array, commanded: Classes) -> float:
    """1 - regret / regret of commands drawn uniformly: 1 for the expert's own, 0 for chance, below 0 if worse.

    NaN if the command makes no difference in any image.
    """
    chance = math.fsum(chance_regrets(action_values))
    return 1.0 - math.fsum(regrets(action_values, commanded)) / chance if chance > 0 else math.nan


def worst(action_values: Array) -> Classes:
    """The command (N, 2) that loses most at each image."""
    flat = action_values.reshape(len(action_values), -1).argmin(axis=1)
    return np.column_stack(np.unravel_index(flat, action_values.shape[1:])).astype(np.int64)


def _mean(values: Array | NDArray[np.bool_]) -> float:
    return float(np.mean(values)) if len(values) else math.nan
