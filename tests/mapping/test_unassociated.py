"""The interval of a count and the depths that it was made with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oysterbench.core.measurements import Image
from oysterbench.mapping import MapSettings
from tests.helpers.flat_reef import LANE, FlatReef, scattered
from tests.mapping.test_density_map import map_of

DISCS = scattered(-1.2, 3.6)
LANES = np.concatenate([LANE, LANE[::-1] + np.array([0.0, 0.5])])
SETTINGS = MapSettings(cell_m=0.5)
SIGMA = 0.08


class Misjudged(FlatReef):
    """Of which every picture's depths are a share off."""

    def __init__(self, seed: int) -> None:
        super().__init__(LANES, DISCS)
        self.times = 1.0 + SIGMA * np.random.default_rng(seed).standard_normal(len(LANES))

    def layer(self, camera, layer, start_ns=None, end_ns=None):
        for image in super().layer(camera, layer, start_ns, end_ns):
            times = self.times[int(np.searchsorted(self.stamps, image.stamp_ns))] if layer == "depth" else 1
            yield Image(image.stamp_ns, camera, (image.pixels * times).astype(image.pixels.dtype))


@pytest.fixture(scope="module")
def exact():
    return map_of(FlatReef(LANES, DISCS), settings=SETTINGS)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_two_sources_of_depth_give_intervals_that_hold_each_others_count(exact, seed):
    rough = map_of(Misjudged(seed), settings=replace(SETTINGS, depth_sigma=SIGMA))
    assert rough.total.count > 1.08 * exact.total.count, "what the error does to association"
    assert rough.total.count_low <= exact.total.count <= rough.total.count_high
    assert rough.total.low_per_m2 <= exact.total.live_per_m2 <= rough.total.high_per_m2
    # Shells that lie side by side hide nothing of one another.
    assert rough.unassociated == pytest.approx(exact.total.count, rel=0.15)


def test_exact_depths_leave_nothing_open(exact):
    assert exact.unassociated is None
