"""Exploring a reef by commands of yaw and pitch: the vehicle, the expert that sees the truth, and dives."""

from oysterbench.steering.dive import explore
from oysterbench.steering.labels import steering_csv
from oysterbench.steering.references import REFERENCES

__all__ = ["REFERENCES", "explore", "steering_csv"]
