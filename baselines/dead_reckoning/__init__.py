"""Inertial dead reckoning: the floor that every other method should beat."""

from oysterbench_baselines.dead_reckoning.method import DeadReckoning, DeadReckoningSettings

__all__ = ["DeadReckoning", "DeadReckoningSettings"]
