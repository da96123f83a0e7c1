"""Scoring trajectories: association, alignment, absolute and relative errors, coverage, and the score."""

from oysterbench.evaluate.slam.scoring import EVALUATOR, SlamResult, SlamSettings, score

__all__ = ["EVALUATOR", "SlamResult", "SlamSettings", "score"]
