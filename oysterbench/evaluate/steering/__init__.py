"""Steering over a reef: classes of commands against those of an expert, and closed-loop rollouts."""

from oysterbench.evaluate.steering.log import RolloutLog
from oysterbench.evaluate.steering.pictures import Commands, Labels, PictureScore, failed_metrics, score_pictures
from oysterbench.evaluate.steering.rollouts import NormalisedScore, normalised_score, score_rollout

EVALUATOR = "navigation 1"
"""Name and version of this evaluator; the version rises whenever a published number may change (docs/versions.md)."""

__all__ = [
    "EVALUATOR",
    "Commands",
    "Labels",
    "NormalisedScore",
    "PictureScore",
    "RolloutLog",
    "failed_metrics",
    "normalised_score",
    "score_pictures",
    "score_rollout",
]
