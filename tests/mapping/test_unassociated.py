"""The interval of a count, and the depths and the path that it was made with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.measurements import Image
from oysterbench.mapping import MapSettings
from tests.helpers.flat_reef import LANE, FlatReef, moved, scattered
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
    assert rough.total.count > exact.total.count, "what the error does to association"
    assert rough.total.count_low <= exact.total.count <= rough.total.count_high
    assert rough.total.low_per_m2 <= exact.total.live_per_m2 <= rough.total.high_per_m2
    # Shells that lie side by side hide nothing of one another.
    assert rough.unassociated == pytest.approx(exact.total.count, rel=0.15)


@pytest.mark.parametrize("off_m", [(0.05, -0.04, 0.0), (-0.025, 0.04, 0.01), (0.06, 0.05, 0.0), (-0.15, 0.15, 0.02)])
def test_a_path_that_is_off_by_centimetres_between_passes_gives_the_true_count(exact, off_m):
    reef = FlatReef(LANES, DISCS)
    path = moved(reef.truth(), np.array(off_m), slice(len(LANE), None))
    found = map_of(reef, path, SETTINGS)
    assert found.total.count == pytest.approx(exact.total.count, rel=0.02)
    assert found.total.count_low <= exact.total.count <= found.total.count_high


def test_a_path_that_is_off_by_more_than_is_looked_for_has_the_true_density_in_its_interval(exact):
    reef = FlatReef(LANES, DISCS)
    path = moved(reef.truth(), np.array([0.28, 0.24, 0.0]), slice(len(LANE), None))
    rough = map_of(reef, path, SETTINGS)
    assert rough.total.count > 1.1 * exact.total.count, "what the error does to association"
    assert rough.total.low_per_m2 <= exact.total.live_per_m2 <= rough.total.high_per_m2
    assert abs(rough.unassociated - exact.total.count) < abs(rough.total.count - exact.total.count)


def test_only_true_depths_along_the_true_path_leave_nothing_open(exact):
    assert exact.unassociated is None
    reef = FlatReef(LANES, DISCS)
    assert map_of(reef, moved(reef.truth(), np.full(3, 2e-4), slice(None)), SETTINGS).unassociated is None, (
        "as a file rounds it"
    )
    assert map_of(reef, moved(reef.truth(), np.full(3, 2e-3), slice(None)), SETTINGS).unassociated is not None


@pytest.mark.parametrize(("turned_deg", "known"), [(1e-4, True), (0.5, False)])
def test_the_true_positions_with_other_attitudes_are_not_the_true_path(turned_deg, known):
    reef = FlatReef(LANES[:3], DISCS)
    truth = reef.truth()
    turn = Rotation.from_euler("z", turned_deg, degrees=True)
    path = replace(truth, quaternions=(turn * Rotation.from_quat(truth.quaternions)).as_quat())
    assert (map_of(reef, path, SETTINGS).unassociated is None) == known


@pytest.mark.parametrize(("poses", "known"), [([0, 7, 8, 15], True), ([0, 4, 8, 15], False), ([0, 15], False)])
def test_poses_of_the_true_path_are_the_true_path_only_if_it_is_straight_between_them(poses, known):
    reef = FlatReef(LANES, DISCS)
    sparse = reef.truth().select(np.array(poses))
    assert (map_of(reef, sparse, replace(SETTINGS, max_gap_s=20.0)).unassociated is None) == known
