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

SPEEDS = ("realtime_factor", "cpu_s_per_s", "steps_per_s", "pictures_per_s")
"""What a failed run has not, whatever it cost: nothing that it got through can be scored."""


def find_metric(key: str, track: str = "") -> Metric | None:
    """The metric of that key, of that track where it has one (each has its own coverage), else of the first that has.

    Those over another time, path, angle, share or class than the listed are found too.
    """
    first = [TRACKS[track]] if track in TRACKS else []
    listed = (each.metrics[key] for each in (*first, *TRACKS.values()) if key in each.metrics)
    return next(listed, None) or find_segmentation(key) or find_slam(key)
