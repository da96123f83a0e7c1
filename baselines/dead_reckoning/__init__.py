"""Inertial dead reckoning: the floor that every other method should beat."""

from oysterbench_baselines.dead_reckoning.method import DeadReckoning, Settings

__all__ = ["DeadReckoning", "Settings"]
