"""What is measured: name, unit, direction and definition of every metric that a result may hold, of every track."""

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


def find_metric(key: str) -> Metric | None:
    """The metric of that key; those over another time, path, angle, share or class than the listed are found too."""
    listed = (track.metrics[key] for track in TRACKS.values() if key in track.metrics)
    return next(listed, None) or find_segmentation(key) or find_slam(key)
