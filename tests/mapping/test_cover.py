"""What the pictures show of the ground lies where they do, however far they were moved."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import TrajectoryError
from oysterbench.mapping.cover import Cover, Raster, raster_around, tile_of, units_m2

RASTER = Raster(-2.0, 2.0, 0.01, 400, 400)
STAYS = np.eye(4)


class PixelCover(Cover):
    """Laid pixel by pixel, the farthest first: another way to the same, without tiles."""

    def add(self, points, distances_m, colours):
        rows, columns, inside = self.raster.index(points[:, :2])
        order = np.argsort(-distances_m[inside], kind="stable")
        rows, columns, near = rows[inside][order], columns[inside][order], distances_m[inside][order]
        seen = np.zeros_like(self.views, dtype=bool)
        seen[rows, columns] = True
        self.views += seen
        better = near <= self._nearest[rows, columns]
        at = rows[better], columns[better]
        self.colours[at] = colours[inside][order][better]
        self._nearest[at] = near[better]


def moved_by(x=0.0, y=0.0, degrees=0.0):
    move = np.eye(4)
    move[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    move[:2, 3] = x, y
    return move


def picture(seed, n=20_000, low=(-0.5, -0.4), high=(0.6, 0.4), millimetres=True):
    """Points (N, 3) m, distances (N,) m, many of which are equal, and colours (N, 3)."""
    generator = np.random.default_rng(seed)
    points = np.column_stack([generator.uniform(low, high, (n, 2)), np.zeros(n)])
    distances_m = generator.uniform(1.0, 1.02, n)
    distances_m = np.round(distances_m, 3) if millimetres else distances_m
    return points, distances_m, generator.integers(0, 256, (n, 3), dtype=np.uint8)


def patch_of_ground(edge_m=0.8):
    """A level square whose every square of the raster is shown, red from the west on."""
    x, y = np.meshgrid(*2 * [np.arange(-edge_m / 2 + 0.0025, edge_m / 2, 0.005)])
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    red = np.rint(255 * (points[:, 0] / edge_m + 0.5)).astype(np.uint8)
    return points, np.ones(len(points)), np.column_stack([red, red * 0, red * 0])


@pytest.mark.parametrize("millimetres", [True, False])
def test_pictures_that_stay_are_laid_as_pixel_by_pixel(millimetres):
    by_tiles, by_pixels = Cover(RASTER), PixelCover(RASTER)
    for seed in range(5):
        # Some of it lies beyond the raster.
        pixels = picture(seed, low=(-0.5, -2.2), high=(2.3, -1.0), millimetres=millimetres)
        by_tiles.lay(tile_of(RASTER, *pixels), STAYS)
        by_pixels.add(*pixels)
    assert by_pixels.views.max() == 5
    assert np.array_equal(by_tiles.views, by_pixels.views)
    assert np.array_equal(by_tiles.colours, by_pixels.colours)


def test_a_picture_is_laid_where_its_move_brings_it():
    stays, moves = Cover(RASTER), Cover(RASTER)
    tile = tile_of(RASTER, *picture(0))
    rows, columns = stays.lay(tile, STAYS)
    found = moves.lay(tile, moved_by(0.3, -0.2))
    assert np.array_equal(found, (rows + 20, columns + 30))
    assert np.array_equal(moves.views, np.roll(stays.views, (20, 30), (0, 1)))
    assert np.array_equal(moves.colours, np.roll(stays.colours, (20, 30), (0, 1)))


@pytest.mark.parametrize("degrees", [-2.0, 0.7, 45.0, 90.0])
def test_a_turned_picture_has_neither_gaps_nor_more_ground(degrees):
    tile, cover = tile_of(RASTER, *patch_of_ground()), Cover(RASTER)
    rows, columns = cover.lay(tile, moved_by(0.123, 0.077, degrees))
    assert len(rows) == pytest.approx(tile.seen.sum(), rel=0.005)
    assert np.array_equal(cover.closed(), cover.views > 0)
    x = RASTER.west_m + 0.01 * (columns + 0.5) - 0.123
    y = RASTER.north_m - 0.01 * (rows + 0.5) - 0.077
    turned_back = Rotation.from_euler("z", -degrees, degrees=True).as_matrix() @ [x, y, 0 * x]
    red = cover.colours[rows, columns, 0].astype(float)
    assert np.abs(red / 255 - (turned_back[0] / 0.8 + 0.5)).max() < 0.02


@pytest.mark.parametrize("order", [(1.0, 2.0), (2.0, 1.0)])
def test_of_two_pictures_the_nearer_gives_the_colour_where_they_were_moved_to(order):
    points, ones, colours = patch_of_ground()
    cover = Cover(RASTER)
    for distance_m in order:
        tile = tile_of(RASTER, points, distance_m * ones, np.full_like(colours, distance_m))
        cover.lay(tile, moved_by(0.2, 0.1, 3.0 * distance_m))
    assert cover.views.max() == 2
    assert np.unique(cover.colours[cover.views == 2]).tolist() == [1]
    assert np.unique(cover.colours[cover.views == 1]).tolist() == [1, 2]


def test_the_raster_grows_by_whole_cells_to_hold_a_picture_that_was_moved_beyond_it():
    tile = tile_of(RASTER, *patch_of_ground())
    move = moved_by(-3.0, 1.9, 10.0)
    grown = RASTER.holding([(tile.raster, STAYS), (tile.raster, move)], 0.5)
    assert (grown.west_m, grown.north_m, grown.rows, grown.columns) == (-3.5, 2.5, 450, 550)
    rows, _ = Cover(grown).lay(tile, move)
    assert len(rows) == pytest.approx(tile.seen.sum(), rel=0.005)
    assert np.array_equal(grown.index(np.array([[0.0, 0.0]]))[0], RASTER.index(np.array([[0.0, 0.0]]))[0] + 50)
    # What does not fit is cut where the raster does not grow.
    assert 0 < len(Cover(RASTER).lay(tile, moved_by(-2.0))[0]) < 0.6 * tile.seen.sum()


def test_the_raster_stays_where_nothing_leaves_it():
    whole = tile_of(RASTER, *picture(0, low=(-3.0, -3.0), high=(3.0, 3.0), n=400_000))
    assert whole.seen.shape == (400, 400)
    assert RASTER.holding([(whole.raster, STAYS)], 0.5) == RASTER
    assert RASTER.holding([], 0.5) == RASTER


def test_a_picture_that_shows_nothing_near_enough_is_laid_nowhere():
    nothing = tile_of(RASTER, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3), dtype=np.uint8))
    cover = Cover(RASTER)
    assert [len(each) for each in cover.lay(nothing, moved_by(1.0, 1.0))] == [0, 0]
    assert RASTER.holding([(nothing.raster, moved_by(-50.0))], 0.5) == RASTER


def test_pictures_that_are_moved_beyond_all_bounds_are_refused():
    tile = tile_of(RASTER, *patch_of_ground())
    with pytest.raises(TrajectoryError, match="has the trajectory diverged"):
        RASTER.holding([(tile.raster, moved_by(1e4, 1e4))], 0.5)


def test_cells_that_are_too_large_for_a_map_are_named_rather_than_the_path():
    places = np.array([[-1.0, -1.0], [1.0, 1.0]])
    with pytest.raises(TrajectoryError, match=r"200 x 200 m: .* are cells of 100 m too large \(--cell\)\?$"):
        raster_around(places, 4.0, 0.01, 100.0)
    with pytest.raises(TrajectoryError, match="has the trajectory diverged"):
        raster_around(places * 1e3, 4.0, 0.01, 1.0)


def test_cells_that_are_too_large_are_named_where_a_move_of_a_picture_adds_one():
    around = raster_around(np.array([[5.0, 10.0], [50.0, 40.0]]), 4.0, 0.01, 60.0)
    points, *rest = patch_of_ground()
    tile = tile_of(around, points + np.array([2.0, 10.0, 0.0]), *rest)
    assert around.holding([(tile.raster, moved_by(-1.0))], 60.0) == around
    with pytest.raises(TrajectoryError, match=r"120 x 60 m: .* are cells of 60 m too large \(--cell\)\?$"):
        around.holding([(tile.raster, moved_by(-5.0))], 60.0)


@pytest.mark.parametrize("edge_m", [0.01, 0.03, 0.2])
def test_the_area_seen_is_the_same_in_squares_of_another_edge(edge_m):
    raster = Raster(-2.0, 2.0, edge_m, 130, 170)
    seen = np.random.default_rng(0).random((130, 170)) < 0.5
    units = units_m2(raster, seen, 0.5)
    assert units.shape == (int(np.ceil(130 * edge_m / 0.5)), int(np.ceil(170 * edge_m / 0.5)))
    assert units.sum() == pytest.approx(seen.sum() * edge_m**2)
    middle = (np.arange(130) + 0.5) * edge_m < 0.5, (np.arange(170) + 0.5) * edge_m < 0.5
    assert units[0, 0] == pytest.approx(seen[np.ix_(*middle)].sum() * edge_m**2)


@pytest.mark.parametrize("often", [2, 3, 8, 10])
def test_what_several_images_show_of_a_larger_square_is_what_was_seen_of_it(often):
    """Where each lacks depths elsewhere, none shows all of it. Across a border of two blocks, too."""
    larger = Raster(-50.0, 50.0, 0.01 * often, 10_000 // often, 10_000 // often)
    west_m = -50.0 + 10 * (256 // often) * larger.edge_m - 0.5
    lattice = Raster(west_m, 1.0, 0.01, 200, 200)
    x, y = np.meshgrid(west_m + np.arange(0.055, 1.455, 0.01), np.arange(-0.295, 0.905, 0.01))
    points = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    checks = (np.floor((x - west_m) / 0.1) + np.floor(y / 0.1)).ravel() % 2 > 0
    both, one, whole = Cover(larger), Cover(larger), Cover(larger)
    for shown in (checks, ~checks):
        both.lay(tile_of(lattice, points[shown], np.ones(shown.sum())), STAYS)
    one.lay(tile_of(lattice, points[checks], np.ones(checks.sum())), STAYS)
    whole.lay(tile_of(lattice, points, np.ones(len(points))), STAYS)
    area_m2 = [cover.seen().sum() * larger.edge_m**2 for cover in (both, one, whole)]
    assert area_m2[0] == pytest.approx(1.4 * 1.2, rel=0.004)
    assert area_m2[2] == pytest.approx(area_m2[0], rel=1e-6)
    assert area_m2[1] == pytest.approx(0.7 * 1.2, rel=0.1)


@pytest.mark.parametrize("often", [2, 8])
def test_small_gaps_between_what_images_show_are_closed_in_larger_squares_too(often):
    larger = Raster(-4.0, 4.0, 0.01 * often, 800 // often, 800 // often)
    cover = Cover(larger)
    for low in (0.105, 0.645):  # 4 cm are between them
        x, y = np.meshgrid(np.arange(low, low + 0.499, 0.01), np.arange(0.105, 0.604, 0.01))
        points = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
        cover.lay(tile_of(Raster(-4.0, 4.0, 0.01, 800, 800), points, np.ones(len(points))), STAYS)
    assert cover.seen().sum() * larger.edge_m**2 == pytest.approx(1.04 * 0.5, rel=1e-6)
