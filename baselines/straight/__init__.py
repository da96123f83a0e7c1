"""The trivial rows of the track steering: straight on, and commands drawn by chance."""

from oysterbench_baselines.straight.method import Chance, Straight

__all__ = ["Chance", "Straight"]
