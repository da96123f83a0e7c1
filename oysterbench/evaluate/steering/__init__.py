"""Steering over a reef: classes of commands against those of an expert, and dives in a closed loop."""

from oysterbench.evaluate.steering.dives import DiveScore, Place, place_between, score_dive
from oysterbench.evaluate.steering.log import DiveLog
from oysterbench.evaluate.steering.pictures import Commands, Labels, PictureScore, score_pictures

EVALUATOR = "navigation 1"
"""Name and version of this evaluator; the version rises whenever a number may change."""

__all__ = [
    "EVALUATOR",
    "Commands",
    "DiveLog",
    "DiveScore",
    "Labels",
    "PictureScore",
    "Place",
    "place_between",
    "score_dive",
    "score_pictures",
]
