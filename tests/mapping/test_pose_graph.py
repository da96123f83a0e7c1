"""Pictures of a dive are laid where they belong together, whatever a path errs by between its passes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.mapping import MapSettings
from oysterbench.mapping.pose_graph import ROUNDS, Step, laid, overlapping, solve
from oysterbench.mapping.projection import Patch

SETTINGS = MapSettings()
EDGE_M = 0.8  # of what a picture shows
LENGTH_M = 4.0


def reef(seed=0, per_m2=60):
    """Places (N, 3) m and areas (N,) m^2 of oysters on 6 x 4 m."""
    generator = np.random.default_rng(seed)
    n = round(24 * per_m2)
    places = np.column_stack([generator.uniform([-1.0, -1.0], [5.0, 3.0], (n, 2)), generator.normal(0.0, 0.01, n)])
    return places, np.exp(generator.normal(np.log(4e-3), 0.4, n))


def there_and_back(step_m=0.2, beside_m=0.3):
    """Places (N, 3) m of a lane, and of its way back beside it."""
    along = np.arange(0.0, LENGTH_M, step_m)
    out, back = (
        np.column_stack([x, np.full(len(x), y), np.ones(len(x))]) for x, y in ((along, 0), (along[::-1], beside_m))
    )
    return np.concatenate([out, back])


def drift(n, metres, degrees):
    """Moves (N, 4, 4) of a path that goes astray evenly, from the first of its pictures to the last."""
    share = np.linspace(0.0, 1.0, n)[:, None]
    moves = np.tile(np.eye(4), (n, 1, 1))
    moves[:, :3, :3] = Rotation.from_euler("z", degrees * share, degrees=True).as_matrix()
    moves[:, :3, 3] = share * metres
    return moves


def pictures_of(oysters, places, moves, sigma_m=0.05, noise_m=0.003, visible=None):
    """What each picture shows, where a path that errs by `moves` lays it."""
    generator = np.random.default_rng(7)
    pictures = []
    for k, (place, move) in enumerate(zip(places, moves, strict=True)):
        shown = np.flatnonzero((np.abs(oysters[0][:, :2] - place[:2]) < EDGE_M / 2).all(axis=1))
        shown = shown if visible is None or visible[k] else shown[:0]
        seen = oysters[0][shown] + generator.normal(0.0, noise_m, (len(shown), 3))
        seen = seen @ move[:3, :3].T + move[:3, 3]
        covariance = (sigma_m**2 + 1e-4) * np.eye(3)
        pictures.append(
            [
                Patch(k, int(n), at[None], at, 100, oysters[1][n], False, covariance, sigma_m, pose_sigma_m=sigma_m)
                for n, at in zip(shown, seen, strict=True)
            ]
        )
    return pictures


def scatter_m(pictures):
    """RMS of the places of an oyster in different pictures, horizontally."""
    of_one = {}
    for picture in pictures:
        for patch in picture:
            of_one.setdefault(patch.number, []).append(patch.centre[:2])
    return float(
        np.sqrt(np.mean(np.concatenate([(np.array(at) - np.mean(at, axis=0)).ravel() ** 2 for at in of_one.values()])))
    )


@pytest.mark.parametrize(("metres", "degrees"), [((0.12, -0.1, 0.03), 0.0), ((0.1, 0.1, 0.0), 2.0)])
def test_two_passes_lie_on_one_another_whatever_the_path_drifts(metres, degrees):
    places = there_and_back()
    strayed = pictures_of(reef(), places, drift(len(places), metres, degrees))
    assert scatter_m(strayed) > 0.02
    found, _ = laid(strayed, places, SETTINGS)
    assert scatter_m(found) < 0.005
    assert max(patch.pose_sigma_m for picture in found for patch in picture) < 0.003


def test_it_tells_how_far_it_is():
    places, told = there_and_back(), []
    strayed = pictures_of(reef(), places, drift(len(places), (0.12, -0.1, 0.03), 0.0))
    laid(strayed, places, SETTINGS, lambda *far: told.append(far))
    assert list(dict.fromkeys(what for what, _, _ in told)) == list(ROUNDS)
    for counted in ROUNDS:
        done = [done for what, done, total in told if what == counted and total == len(places)]
        assert done == sorted(done)
        assert done[-1] == len(places)


def test_heights_are_mended_too():
    places = there_and_back()
    found, _ = laid(pictures_of(reef(), places, drift(len(places), (0.0, 0.0, 0.08), 0.0)), places, SETTINGS)
    middles = [np.mean([patch.centre[2] for patch in picture]) for picture in found]
    assert np.ptp(middles) < 0.01


def test_nothing_moves_along_a_path_that_is_sure():
    places = there_and_back()
    exact = pictures_of(reef(), places, drift(len(places), (0.0, 0.0, 0.0), 0.0), sigma_m=0.0)
    found, moves = laid(exact, places, SETTINGS)
    assert found == exact
    assert np.array_equal(moves, np.tile(np.eye(4), (len(places), 1, 1)))


def test_pictures_of_bare_ground_stay_where_they_are_and_the_others_find_each_other():
    places = there_and_back()
    visible = np.arange(len(places)) % 10 < 7
    strayed = pictures_of(reef(), places, drift(len(places), (0.1, -0.08, 0.0), 0.0), visible=visible)
    found, _ = laid(strayed, places, SETTINGS)
    assert [bool(picture) for picture in found] == visible.tolist()
    assert scatter_m(found) < 0.005


def test_pictures_of_bare_ground_are_moved_as_those_before_and_after():
    places, metres = there_and_back(), np.array([0.1, -0.08, 0.0])
    visible = np.arange(len(places)) % 10 % 8 > 2  # among others neither the first nor the last
    assert not visible[[0, -1]].any()
    strays = drift(len(places), metres, 2.0)
    shown = np.column_stack([places, np.ones(len(places))])[..., None]
    moves = laid(pictures_of(reef(), places, strays, visible=visible), (strays @ shown)[:, :3, 0], SETTINGS)[1]
    # Where each is laid by its own move, and by those of the nearest that show oysters.
    undone = moves @ strays
    for k in np.flatnonzero(~visible):
        near = [side[0] for side in (np.flatnonzero(visible[:k])[::-1], k + np.flatnonzero(visible[k:])) if len(side)]
        by_near = np.mean([undone[j] @ shown[k] for j in near], axis=0)
        assert np.linalg.norm((undone[k] @ shown[k] - by_near)[:3]) < (0.004 if len(near) == 2 else 0.02)
    assert np.ptp((strays @ shown - shown)[:, 1]) > 0.08


def fitted(there, places):
    """The shift (m) and turn (rad) by which moved places lie off those of the path, in the least squares."""
    a, b = (one[:, 0] + 1j * one[:, 1] for one in (there, places))
    return abs(b.mean() - a.mean()), np.angle(((b - b.mean()) * np.conj(a - a.mean())).sum())


def test_the_map_as_a_whole_lies_on_the_path_whose_headings_err_otherwise_than_its_places():
    """A path that turns more and more while it goes on, as one with a gyroscope's bias."""
    places = there_and_back()
    strays = drift(len(places), (0.25, -0.2, 0.05), 0.0)
    turned = [Rotation.from_euler("z", 1.5 * share, degrees=True) for share in np.linspace(0.0, 1.0, len(places))]
    path = places + strays[:, :3, 3]
    for k, turn in enumerate(turned):  # about where the vehicle is
        strays[k, :3, :3] = turn.as_matrix()
        strays[k, :3, 3] = path[k] - turn.apply(places[k])
    found, moves = laid(pictures_of(reef(), places, strays), path, SETTINGS)
    assert scatter_m(found) < 0.006
    there = (moves[:, :3, :3] @ path[..., None])[..., 0] + moves[:, :3, 3]
    shift_m, turn_rad = fitted(there, path)
    assert shift_m < 1e-9
    assert abs(turn_rad) < 1e-9
    # And so it does on the truth: by as much as the path itself, however it is aligned.
    assert abs(fitted(there, places)[1] - fitted(path, places)[1]) < 1e-3


def test_a_vehicle_that_stays_where_it_is_turns_nothing():
    """Its path is noise."""
    generator = np.random.default_rng(1)
    places = np.array([0.3, 0.2, 1.0]) + generator.normal(0.0, 0.02, (12, 3))
    strays = drift(len(places), (0.0, 0.0, 0.0), 0.0)
    strays[:, :2, 3] = generator.normal(0.0, 0.03, (12, 2))
    moves = laid(pictures_of(reef(), places, strays), places + strays[:, :3, 3], SETTINGS)[1]
    assert abs(fitted(places, places + strays[:, :3, 3])[1]) > 0.1
    assert np.abs(Rotation.from_matrix(moves[:, :3, :3]).as_rotvec()[:, 2]).max() < 0.01


def test_a_picture_that_shows_too_few_moves_with_its_neighbours_and_is_less_sure():
    places = there_and_back()
    pictures = pictures_of(reef(), places, drift(len(places), (0.12, -0.1, 0.0), 0.0))
    k = 30
    pictures[k] = pictures[k][:2]
    found, _ = laid(pictures, places, SETTINGS)
    assert scatter_m(found) < 0.006
    assert found[29][0].pose_sigma_m < 0.003 < found[k][0].pose_sigma_m < 0.01


def test_no_oysters_or_one_picture_are_no_trouble():
    places = there_and_back()[:3]
    assert laid([], np.zeros((0, 3)), SETTINGS)[0] == []
    assert laid([[], [], []], places, SETTINGS)[0] == [[], [], []]
    alone = pictures_of(reef(), places[:1], drift(1, (0.0, 0.0, 0.0), 0.0))
    (found,), _ = laid(alone, places[:1], SETTINGS)
    assert np.allclose([patch.centre for patch in found], [patch.centre for patch in alone[0]])
    assert found[0].pose_sigma_m == pytest.approx(0.05)


def test_steps_of_the_wrong_oysters_lose_their_weight():
    n, shift = 40, np.array([0.07, -0.05, 0.01])
    middles = np.column_stack([0.2 * np.minimum(np.arange(n), n - 1 - np.arange(n)), np.zeros(n), np.zeros(n)])
    own = [Step(k, k + 1, middles[k + 1], middles[k + 1], 0.0, 0.004, 0.002) for k in range(n - 1)]
    # The way back shows the ground of the way out; a quarter of the steps between them are of other oysters.
    wrong = np.random.default_rng(3).uniform(-0.15, 0.15, (10, 3)) * [1.0, 1.0, 0.1]
    told = [
        Step(j, k, middles[k] - (wrong[(j + k) % 10] if (j + k) % 4 == 0 else shift), middles[k], 0.0, 0.003, 0.003)
        for k in range(30, n)
        for j in range(n - k, n - k + 5)
    ]
    moves, sigmas = solve(own, told, middles, np.full(n, 0.05))
    there = (moves @ np.column_stack([middles, np.ones(n)])[..., None])[:, :3, 0] - middles
    assert np.allclose(there[32:38] - there[2], shift, atol=0.006)
    assert sigmas[35] < 0.002


def test_each_picture_has_so_many_partners_at_most():
    still = np.zeros((60, 3))
    pairs = list(overlapping(pictures_of(reef(), still, drift(60, (0.0, 0.0, 0.0), 0.0))))
    of_last = [earlier for earlier, later in pairs if later == 59]
    assert len(of_last) == 24
    assert of_last[0] == 0
    assert of_last[-1] == 58
