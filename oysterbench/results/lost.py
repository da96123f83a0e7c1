"""Sequences on which a method got lost, and what it achieves on the others.

An estimate that diverges may be off by any distance, so that a mean of errors over sequences would say nothing about
the others. An error over sequences is therefore the median over those that are not lost, shown beside the number lost.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.statistics import Sample, sequence_means


def lost_sequences(scores: Sample, track: str) -> tuple[str, ...] | None:
    """Names of the sequences whose score, the mean over their runs, is below the track's `lost_below`; None if the
    track does not define it.

    scores: values of the ranking metric; a failed run has one too, the lowest

    >>> lost_sequences({"a": [0.9], "b": [0.0], "c": [0.4, 0.0]}, "slam")
    ('b', 'c')
    """
    least = TRACKS[track].lost_below
    return None if least is None else tuple(name for name, score in sequence_means(scores).items() if score < least)


def kept_median(values: Sample, lost: Collection[str]) -> float:
    """The median over the sequences that are not lost and have a value, of the means of their runs; NaN where there is
    none.

    >>> kept_median({"a": [0.1], "b": [34000.0], "c": [0.2, 0.4]}, ["b"])
    0.2
    """
    kept = [value for name, value in sequence_means(values).items() if name not in lost]
    return float(np.median(kept)) if kept else math.nan
