"""Results over a data set: every metric from the sum of all counts, with an interval by resampling clips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oysterbench.evaluate.segmentation.clip import ClipResult, join
from oysterbench.evaluate.segmentation.computation import measure
from oysterbench.evaluate.statistics import Interval, resample_counts, resampled_interval, too_few


@dataclass(frozen=True)
class DatasetResult:
    """The result over all clips, and the interval of each of its metrics. Neighbouring frames are near-duplicates, so
    clips are resampled, each with all its images."""

    whole: ClipResult
    intervals: Mapping[str, Interval]
    clips: int


def over_dataset(clips: Sequence[ClipResult]) -> DatasetResult:
    """Compute the result over all clips together, and the intervals of its metrics."""
    whole = join(list(clips))
    drawn = resample_counts(len(clips))
    if drawn is None:
        unknown = Interval(np.nan, np.nan, too_few(len(clips)))
        return DatasetResult(whole, dict.fromkeys(whole.metrics, unknown), len(clips))
    sums = {key: drawn @ np.array([clip.tally.get(key, 0.0) for clip in clips]) for key in whole.tally}
    values, _ = measure(sums)
    return DatasetResult(
        whole, {key: resampled_interval(found, len(clips)) for key, found in values.items()}, len(clips)
    )
