"""What a method is; finding one by its name, running it, measuring the run."""

from oysterbench.methods.finding import ENTRY_POINTS, find_method, method_names
from oysterbench.methods.health import Health
from oysterbench.methods.here import Run, run_method
from oysterbench.methods.map import LandmarkMap
from oysterbench.methods.method import Estimate, Method, seed_of

__all__ = [
    "ENTRY_POINTS",
    "Estimate",
    "Health",
    "LandmarkMap",
    "Method",
    "Run",
    "find_method",
    "method_names",
    "run_method",
    "seed_of",
]
