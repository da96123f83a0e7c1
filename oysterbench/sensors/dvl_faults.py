"""Faults of a DVL: pings without bottom lock, wrong velocities, late messages, and fewer pings at higher altitudes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams

if TYPE_CHECKING:
    from oysterbench.sensors.dvl import DvlRecipe

TIME_DIGITS = 6  # decimals of a second to which pings are timed
ARRIVAL_STEP_NS = 1_000_000  # least time between the arrivals of two messages


@dataclass(frozen=True)
class Strikes:
    """Faults of pings: risky (N,): over plants or low; invalid (N,): without bottom lock; outliers (N,) m/s: error of
    one beam's velocity, 0 where there is none."""

    risky: NDArray[np.bool_]
    invalid: NDArray[np.bool_]
    outliers: Array


def strike(recipe: DvlRecipe, risky: NDArray[np.bool_], streams: Streams) -> Strikes:
    """Draw the faults of pings (N,), of which some are risky; streams: the DVL's branch."""
    n = len(risky)

    def struck(elsewhere: float, there: float | None, name: str) -> NDArray[np.bool_]:
        share = np.where(risky, elsewhere if there is None else there, elsewhere)
        return np.asarray(streams.generator(name).random(n) < share) if share.any() else np.zeros(n, dtype=bool)

    invalid = struck(recipe.invalid, recipe.invalid_risky, "invalid")
    wrong = struck(recipe.outliers, recipe.outliers_risky, "outlier") & ~invalid
    sizes = recipe.outlier_m_s * streams.generator("outlier", "size").standard_normal(n) if wrong.any() else np.zeros(n)
    return Strikes(risky, invalid, np.where(wrong, sizes, 0.0))


def ping_times(recipe: DvlRecipe, duration_s: float, altitude: Callable[[float], float]) -> Array:
    """Times (N,) s of the pings in a sequence: the higher the DVL is, altitude(t) m, the longer it waits for echoes."""
    shortest, longest = 1.0 / recipe.rate_hz, 1.0 / (recipe.min_rate_hz or recipe.rate_hz)
    times = [0.0]
    while times[-1] < duration_s:
        share = min(1.0, altitude(times[-1]) / recipe.max_range_m)
        times.append(round(times[-1] + shortest + (longest - shortest) * share, TIME_DIGITS))
    return np.array(times[:-1])


def arrivals(recipe: DvlRecipe, stamps_ns: NDArray[np.int64], streams: Streams) -> NDArray[np.int64]:
    """Stamps (N,) of arrival, ns: late by 0.5 to 1.5 times the latency, and in order."""
    if not recipe.latency_ms:
        return stamps_ns
    late = recipe.latency_ms * 1e6 * streams.generator("dvl", "latency").uniform(0.5, 1.5, len(stamps_ns))
    steps = ARRIVAL_STEP_NS * np.arange(len(stamps_ns))
    return np.asarray(np.maximum.accumulate(stamps_ns + np.rint(late).astype(np.int64) - steps) + steps)
