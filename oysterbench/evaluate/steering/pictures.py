"""Scoring of commands for labelled images: by axis, and what the commands lose in oysters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.geometry import Array
from oysterbench.evaluate.steering import labels
from oysterbench.evaluate.values import Score
from oysterbench.recipe.steering import SteeringRecipe

AXES = ("yaw", "pitch")
NO_PICTURES = "no image has a command"


@dataclass(frozen=True)
class Labels:
    """Commands of the expert: classes (N, 2) int64 of yaw, pitch; action_values (N, Y, P) of each pair in oysters.

    Raises LabelError if they do not fit the task, or a number is not finite.
    """

    classes: NDArray[np.int64]
    action_values: Array
    task: SteeringRecipe
    where: str = "labels"

    def __post_init__(self) -> None:
        n, sizes = len(self.classes), (len(self.task.yaw_deg), len(self.task.pitch_deg))
        if self.action_values.shape != (n, *sizes):
            raise LabelError(
                f"{self.where}: expected the action values of {n} images for {sizes[0]} x {sizes[1]} classes, got "
                f"the shape {self.action_values.shape}"
            )
        if ((self.classes < 0) | (self.classes >= sizes)).any():
            raise LabelError(
                f"{self.where}: expected classes of yaw from 0 to {sizes[0] - 1} and of pitch from 0 to "
                f"{sizes[1] - 1}, got {self.classes.min(axis=0).tolist()} to {self.classes.max(axis=0).tolist()}"
            )
        if not np.isfinite(self.action_values).all():
            k = int(np.flatnonzero(~np.isfinite(self.action_values).all(axis=(1, 2)))[0])
            raise LabelError(f"{self.where}: image {k + 1}: expected finite action values, got another")


@dataclass(frozen=True)
class Commands:
    """Commands of a policy: classes (N, 2) int64; probabilities (N, Y) and (N, P), each row of which adds up to 1."""

    classes: NDArray[np.int64]
    yaw_probability: Array
    pitch_probability: Array


@dataclass(frozen=True)
class PictureScore(Score):
    """Values by keys of `metrics.PICTURES`; yaw, pitch: number of images by the expert's class (row) and the commanded
    one (column)."""

    yaw: NDArray[np.int64]
    pitch: NDArray[np.int64]


def failed_metrics(truth: Labels) -> dict[str, float]:
    """Metrics of a run that failed: the skill of the worst command at each image, so that no answer ranks below none;
    at most 0, also where no command makes a difference."""
    worst = labels.skill(truth.action_values, labels.worst(truth.action_values)) if len(truth.classes) else 0.0
    return {"skill": min(0.0, worst)}


def score_pictures(truth: Labels, commands: Commands) -> PictureScore:
    """Score the commands for N images."""
    n, task = len(truth.classes), truth.task
    metrics: dict[str, float] = {"skill": labels.skill(truth.action_values, commands.classes)}
    metrics["regret_oysters"] = float(labels.regrets(truth.action_values, commands.classes).mean()) if n else math.nan
    counts = []
    for k, (axis, degrees) in enumerate(zip(AXES, (task.yaw_deg, task.pitch_deg), strict=True)):
        true, commanded = truth.classes[:, k], commands.classes[:, k]
        probability = commands.yaw_probability if k == 0 else commands.pitch_probability
        counts.append(labels.confusion(true, commanded, len(degrees)))
        metrics[f"{axis}_accuracy"] = labels.accuracy(true, commanded)
        metrics[f"{axis}_balanced_accuracy"] = labels.balanced_accuracy(counts[-1])
        metrics[f"{axis}_macro_f1"] = labels.macro_f1(counts[-1])
        metrics[f"{axis}_within_one"] = labels.within_one(true, commanded)
        steps = np.arange(len(degrees), dtype=float)
        metrics[f"{axis}_cost_classes"] = labels.expected_cost(true, probability, steps)
        metrics[f"{axis}_cost_deg"] = labels.expected_cost(true, probability, np.array(degrees))
    metrics["joint_accuracy"] = labels.joint_accuracy(truth.classes, commands.classes)
    metrics["pictures"] = float(n)
    reasons = {key: NO_PICTURES for key, value in metrics.items() if math.isnan(value)}
    if n and "skill" in reasons:
        reasons["skill"] = "the command makes no difference in any image"
    return PictureScore(metrics, reasons, *counts)
