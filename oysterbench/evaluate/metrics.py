"""Name, unit, direction and definition of every metric that a result of any track may contain."""

from __future__ import annotations

from oysterbench.evaluate.density.metrics import TRACK as DENSITY
from oysterbench.evaluate.detection.metrics import TRACK as DETECTION
from oysterbench.evaluate.metric import Metric, TrackMetrics
from oysterbench.evaluate.segmentation.metrics import TRACK as SEGMENTATION
from oysterbench.evaluate.segmentation.metrics import find_segmentation
from oysterbench.evaluate.slam.metrics import TRACK as SLAM
from oysterbench.evaluate.slam.metrics import find_slam
from oysterbench.evaluate.steering.metrics import EXPLORATION, STEERING

TRACKS: dict[str, TrackMetrics] = {
    "slam": SLAM,
    "segmentation": SEGMENTATION,
    "detection": DETECTION,
    "density": DENSITY,
    "steering": STEERING,
    "exploration": EXPLORATION,
}
"""Track -> its metrics."""

FAILED = {name: track.failed for name, track in TRACKS.items()}
"""Track -> the values of a run without a scored estimate."""

SPEEDS = ("realtime_factor", "cpu_s_per_s", "steps_per_s", "pictures_per_s", "images_per_s")
"""Metrics that a failed run does not have, whatever it cost: nothing that it processed can be scored."""

TIMES = (*SPEEDS, "cpu_s")
"""Metrics in tables that depend on the machine: those of different machines do not compare methods."""


def find_metric(key: str, track: str = "") -> Metric | None:
    """Find the metric with this key in the given track, or else in the first track that has it; None if none does.

    The track matters, as each has its own coverage, for example. Metrics over another time, path length, angle, share
    or class than the listed ones are found too.
    """
    first = [TRACKS[track]] if track in TRACKS else []
    listed = (each.metrics[key] for each in (*first, *TRACKS.values()) if key in each.metrics)
    return next(listed, None) or find_segmentation(key) or find_slam(key)
