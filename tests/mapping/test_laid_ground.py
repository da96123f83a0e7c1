"""Along a path that drifts, the ground that pictures show lies where their oysters do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.mapping import MapSettings, survey
from oysterbench.mapping.pose_graph import laid
from oysterbench.mapping.projection import Lens
from oysterbench.report.density_files import write_map
from tests.helpers.flat_reef import LANE, FlatReef, moved, scattered
from tests.mapping.test_cover import PixelCover
from tests.mapping.test_density_map import map_of

SETTINGS = MapSettings(cell_m=0.5)
LANES = np.concatenate([LANE, LANE[::-1] + np.array([0.0, 0.35]), LANE + np.array([0.0, 0.7])])
DRIFT_M, DRIFT_DEG = np.array([0.0, -0.2, 0.0]), 2.0  # which turn the dive as a whole by nothing
REEF = FlatReef(LANES, scattered(-1.2, 3.6))


def strayed(trajectory):
    """A path that errs by more and more, by nothing in its middle: so that its map lies on the true one."""
    share = np.linspace(-0.5, 0.5, len(trajectory))[:, None]
    turns = Rotation.from_euler("z", DRIFT_DEG * share, degrees=True)
    middle = trajectory.positions.mean(axis=0)
    return replace(
        trajectory,
        positions=turns.apply(trajectory.positions - middle) + middle + share * DRIFT_M,
        quaternions=(turns * Rotation.from_quat(trajectory.quaternions)).as_quat(),
    )


def without_moves(*arguments):
    """The oysters where they belong, and the ground where the path has it."""
    pictures, moves = laid(*arguments)
    return pictures, np.tile(np.eye(4), (len(moves), 1, 1))


@pytest.fixture(scope="module")
def true():
    # Off by as much as makes a path one whose pictures are laid to each other.
    return map_of(REEF, moved(REEF.truth(), np.full(3, 2e-3), slice(None)), SETTINGS)


@pytest.fixture(scope="module")
def found():
    return map_of(REEF, strayed(REEF.truth()), SETTINGS)


@pytest.fixture(scope="module")
def unmoved():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(survey, "laid", without_moves)
        return map_of(REEF, strayed(REEF.truth()), SETTINGS)


def test_the_area_is_that_along_the_true_path(true, found, unmoved):
    off, off_unmoved = (abs(one.total.area_m2 - true.total.area_m2) for one in (found, unmoved))
    assert off < 0.01 * true.total.area_m2
    assert off < 0.3 * off_unmoved


def seen_by_one_alone(one, other):
    """m^2."""
    assert one.cover.raster == other.cover.raster
    return float((one.cover.closed() != other.cover.closed()).sum()) * one.cover.raster.edge_m**2


def test_what_was_seen_lies_where_it_does_along_the_true_path(true, found, unmoved):
    assert seen_by_one_alone(found, true) < 0.4 * seen_by_one_alone(unmoved, true)
    assert seen_by_one_alone(found, true) < 0.02 * true.total.area_m2


def colour_off(one, true):
    """Mean difference of the mosaics, on what both show."""
    both = (one.cover.views > 0) & (true.cover.views > 0)
    return float(np.abs(one.cover.colours[both].astype(float) - true.cover.colours[both]).mean())


def test_the_mosaic_is_that_along_the_true_path(true, found, unmoved):
    assert colour_off(found, true) < 0.5 * colour_off(unmoved, true)


def test_oysters_lie_on_their_pictures(found, unmoved):
    """Grey of shells is 200, of the bottom 90."""

    def on_shells(one):
        middles = np.array([track.centre[:2] for track in one.tracks if track.whole])
        rows, columns, _ = one.cover.raster.index(middles)
        return float((one.cover.colours[rows, columns, 0] == 200).mean())

    assert on_shells(found) > 0.99
    assert on_shells(unmoved) < 0.9


def test_densities_are_those_along_the_true_path(true, found, unmoved):
    def off(one):
        known = one.grid.known & true.grid.known
        return float(np.abs(one.grid.density - true.grid.density)[known].mean())

    assert found.total.count == pytest.approx(true.total.count, rel=0.01)
    assert off(found) < 0.6 * off(unmoved)


@pytest.mark.slow
def test_along_a_sure_path_every_file_is_as_of_pixels_laid_one_by_one(tmp_path):
    """Nothing moves, so that tiles make no difference."""
    one = map_of(REEF, settings=SETTINGS)
    cover = PixelCover(one.cover.raster)
    calibration, lens = REEF.cameras["cam"], Lens("cam", REEF.cameras["cam"])
    for image, pose in zip(REEF.images("cam"), REEF.truth().matrices, strict=True):
        points = lens.points(np.ones(lens.shape), pose @ calibration.T_base_cam)
        cover.add(points.reshape(-1, 3), np.ones(points[..., 0].size), image.pixels.reshape(-1, 3))
    assert np.array_equal(one.cover.views, cover.views)
    first, second = (
        {path.name: path.read_bytes() for path in write_map(each, tmp_path / name)}
        for each, name in ((one, "tiles"), (replace(one, cover=cover), "pixels"))
    )
    assert first == second


def test_a_picture_that_is_moved_beyond_the_path_is_not_cut(monkeypatch):
    """Its ground lies 8 m farther north than any that the path leads to."""
    north = np.eye(4)
    north[1, 3] = 8.0

    def carried_off(*arguments):
        pictures, moves = laid(*arguments)
        return [[patch.placed(north) for patch in picture] for picture in pictures], north @ moves

    path = strayed(REEF.truth())
    here = map_of(REEF, path, SETTINGS)
    monkeypatch.setattr(survey, "laid", carried_off)
    there = map_of(REEF, path, SETTINGS)
    assert there.cover.raster.rows > here.cover.raster.rows
    assert there.total.area_m2 == pytest.approx(here.total.area_m2, rel=1e-3)
    assert there.grid.counts["live"].sum() == here.grid.counts["live"].sum()
    assert there.unassociated == pytest.approx(here.unassociated, rel=0.01)
    assert np.array_equal(there.grid.density[there.grid.known], here.grid.density[here.grid.known])
