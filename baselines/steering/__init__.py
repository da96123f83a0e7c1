"""Behavioural cloning: a small network that steers by what the front camera shows."""

from oysterbench_baselines.steering.method import SteeringNet

__all__ = ["SteeringNet"]
