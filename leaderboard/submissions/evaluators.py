"""The evaluators that boards rank by, as this version of oysterbench has them."""

from __future__ import annotations

from typing import Any

from oysterbench_leaderboard.submissions.catalogue import why
from oysterbench_leaderboard.submissions.refusals import Refusal


def evaluator(track: str) -> tuple[str, dict[str, Any]]:
    """Name and version of a track's evaluator, and its settings: those that boards rank by. Raises Refusal for a track
    that cannot be submitted."""
    if track == "slam":
        from oysterbench.evaluate.slam import scoring as slam

        return slam.EVALUATOR, slam.SlamSettings().as_dict()
    if track == "segmentation":
        from oysterbench.evaluate import segmentation

        return segmentation.EVALUATOR, segmentation.SegmentationSettings().as_dict()
    if track == "detection":
        from oysterbench.evaluate import detection

        return detection.EVALUATOR, detection.DetectionSettings().as_dict()
    if track == "steering":
        from oysterbench.evaluate import steering as navigation

        return navigation.EVALUATOR, {}
    raise Refusal("split", f"the track {track!r:.60} cannot be submitted{why(track)}")
