"""The track steering, run: methods over labelled pictures, and pilots in a closed loop over reefs."""

from oysterbench.exploring.dives import Loop, make_loop, run_dives
from oysterbench.exploring.labelled import labelled_views
from oysterbench.exploring.pictures import evaluate_pictures

__all__ = ["Loop", "evaluate_pictures", "labelled_views", "make_loop", "run_dives"]
