"""Timestamps of a sensor's messages, and which of the messages arrive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.streams import Streams
from oysterbench.recipe.sensors import SensorRecipe

MOST_JITTER = 0.45
"""Largest jitter, as a share of the sampling interval."""


def stamps(n: int, rate_hz: float, epoch_ns: int, offset_ms: float = 0.0) -> NDArray[np.int64]:
    """Timestamps (n,), int64 ns, of samples taken k / rate_hz s after the epoch, by a clock that is offset_ms ahead."""
    since_ns: NDArray[np.int64] = np.rint(np.arange(n) * (1e9 / rate_hz)).astype(np.int64)
    return since_ns + (epoch_ns + round(offset_ms * 1e6))


def jitter(n: int, rate_hz: float, sigma_s: float, streams: Streams) -> NDArray[np.int64]:
    """Timestamp jitter (n,), int64 ns: zero-mean, with a standard deviation in s, and limited so that no two stamps
    change order.

    streams: the branch of the sensors that are stamped together.
    """
    late = sigma_s * streams.generator("jitter").standard_normal(n)
    most = MOST_JITTER / rate_hz
    return np.rint(1e9 * np.clip(late, -most, most)).astype(np.int64)


def kept(n: int, recipe: SensorRecipe, streams: Streams) -> NDArray[np.bool_]:
    """Mask (n,) of the messages that arrive; streams: the sensor's own branch.

    A two-state chain in which one state loses every message (Gilbert 1960): runs of received and of lost messages
    alternate, each of geometric length; a share `dropout` of all is lost, in bursts of `dropout_burst` on average.
    """
    if not recipe.dropout:
        return np.ones(n, dtype=bool)
    lost_mean = recipe.dropout_burst
    kept_mean = lost_mean * (1 - recipe.dropout) / recipe.dropout
    # The first message is as likely to be lost as any other, and what remains of a geometric run is geometric too.
    starts_lost = bool(streams.generator("losses", "start").random() < recipe.dropout)
    pairs = n // 2 + 1  # a run holds at least one message, so these reach past the last
    lengths = [
        np.minimum(streams.generator("losses", name).geometric(1 / round(mean, 12), pairs), n)
        for name, mean in (("kept", kept_mean), ("lost", lost_mean))
    ]
    ends = np.cumsum(np.column_stack(lengths[::-1] if starts_lost else lengths).ravel())
    run = np.searchsorted(ends, np.arange(n), side="right")
    return np.asarray((run % 2 == 1) == starts_lost)
