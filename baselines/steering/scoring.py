"""Score of a network on examples that it was not trained on, reported at the end of a training."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oysterbench.evaluate.steering.labels import regrets, skill, within_one
from oysterbench_baselines.steering.examples import TrainingExamples
from oysterbench_baselines.steering.model import SteeringModel


@dataclass(frozen=True)
class Score:
    """Score over a number of views. regret: oysters lost per command; skill: 1 for the expert, 0 for chance; yaw,
    pitch: share of views whose class is the expert's or one next to it."""

    views: int
    regret: float
    skill: float
    yaw: float
    pitch: float

    def __str__(self) -> str:
        return (
            f"skill {self.skill:.3f}, regret {self.regret:.2f} oysters, within one class {100 * self.yaw:.1f} % of yaw "
            f"and {100 * self.pitch:.1f} % of pitch, on {self.views} views"
        )


def score(model: SteeringModel, examples: TrainingExamples) -> Score:
    """Score the most probable classes of a model on examples."""
    commanded = np.stack([prediction.argmax(axis=1) for prediction in model.predictions(examples)], axis=1)
    action_values = examples.action_values.astype(float)
    flat = action_values.reshape(len(action_values), -1).argmax(axis=1)
    truth = np.stack(np.unravel_index(flat, action_values.shape[1:]), axis=1)
    return Score(
        len(examples),
        float(regrets(action_values, commanded).mean()),
        skill(action_values, commanded),
        within_one(truth[:, 0], commanded[:, 0]),
        within_one(truth[:, 1], commanded[:, 1]),
    )
