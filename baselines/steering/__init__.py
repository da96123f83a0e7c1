"""Behavioural cloning: a small network that steers by the images of the front camera."""

from oysterbench_baselines.steering.method import SteeringNet

__all__ = ["SteeringNet"]
