"""Along which path a map is made, what is behind its entries, and what is no failure of a method."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from oysterbench.core.errors import LabelError, MachineError
from oysterbench.core.geometry import transform
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.frames import poses_of_body, poses_of_frame, scaled
from oysterbench.mapping import MapSettings, Seen
from oysterbench.tracks.mapping_evaluation import MappedSequence, _owned, aligned, evaluate_maps, map_count
from tests.helpers.dives import survey
from tests.helpers.flat_reef import LANE, FlatReef, scattered


@pytest.mark.parametrize("scale", [0.1, 3.0])
def test_a_map_is_made_along_the_aligned_path_of_a_camera_without_scale(scale):
    truth, place = survey(), transform(np.eye(3), np.array([0.4, 0.0, -0.1]))
    camera = replace(poses_of_frame(truth, place), T_body_estimate=None)
    path = aligned(truth, poses_of_body(scaled(camera, scale), place), "sim3")
    np.testing.assert_allclose(path.positions, truth.positions, rtol=0, atol=1e-9)


def test_an_aligned_path_has_its_uncertainty_in_metres_too():
    truth = survey()
    one_cm = np.tile(np.diag([1e-4] * 3 + [4e-4] * 3), (len(truth), 1, 1))
    path = aligned(truth, scaled(replace(truth, covariances=one_cm), 0.1), "sim3")
    np.testing.assert_allclose(path.covariances, one_cm, rtol=1e-6, atol=1e-12)


def test_masks_of_unlabelled_images_take_no_oyster_from_those_that_are_labelled():
    reef = FlatReef(LANE[:3], scattered(-0.6, 1.2))
    labelled = [Seen(int(stamp), "cam", reef.numbers(k)) for k, stamp in enumerate(reef.stamps)]
    between = [replace(one, stamp_ns=one.stamp_ns + 200_000_000) for one in labelled]
    masks = sorted([*labelled, *between], key=lambda one: one.stamp_ns)
    alone, among = ({}, {})
    for seen, owners in ((labelled, alone), (masks, among)):
        assert len(list(_owned(reef, "cam", lambda seen=seen: seen, owners)())) == len(seen)
    assert len({frame for frame, _ in alone}) == 3
    assert {(frame // 2, number): own for (frame, number), own in among.items()} == alone
    assert not any(frame % 2 for frame, _ in among)


def test_an_oyster_is_behind_an_entry_by_the_images_that_are_labelled():
    patches = [SimpleNamespace(frame=k, number=1, pixels=100 if k else 60) for k in range(3)]
    entries = [SimpleNamespace(patches=patches), SimpleNamespace(patches=patches[1:])]
    counts = dict.fromkeys(("live", "unknown"), np.zeros((1, 1)))
    grid = SimpleNamespace(known=np.zeros((1, 1), bool), west_m=0.0, north_m=0.0, cell_m=1.0, counts=counts)
    total = SimpleNamespace(live=2, dead=0, unknown=0, count=2, count_low=1, count_high=3)
    scored = map_count(SimpleNamespace(tracks=entries, grid=grid, total=total), {(0, 1): 7})
    assert (list(scored.owners), set(scored.found)) == ([7, 0], {7})


def test_masks_that_the_machine_failed_to_make_are_no_failure_of_their_method():
    def killed():
        raise MachineError("killed by SIGKILL (out of memory?)")
        yield

    mapped = MappedSequence(FlatReef(LANE[:3], scattered(-0.6, 1.2)), "cam", {}, {"mine": killed})
    with pytest.raises(MachineError, match="out of memory"):
        list(evaluate_maps(mapped, None, MapSettings(cell_m=0.5)))


def test_masks_of_the_user_that_cannot_be_read_are_no_failure_of_any_path():
    def damaged():
        raise LabelError("5.png: damaged")
        yield

    mapped = MappedSequence(FlatReef(LANE[:3], scattered(-0.6, 1.2)), "cam", {}, {"mine": damaged})
    with pytest.raises(LabelError, match=r"5\.png: damaged"):
        list(evaluate_maps(replace(mapped, own_masks=True), None, MapSettings(cell_m=0.5)))
    (run,) = evaluate_maps(mapped, None, MapSettings(cell_m=0.5))
    assert run.record.failure == "5.png: damaged", "those of a method are its failure"


def test_a_path_that_does_not_fit_the_squares_of_the_settings_has_no_score():
    reef = FlatReef(LANE, scattered(-0.6, 1.2))
    path = reef.truth()
    away = Trajectory(
        np.append(path.stamps_ns, path.stamps_ns[-1] + 10**11),
        np.vstack([path.positions, [2e3, 2e3, path.positions[0, 2]]]),
        np.vstack([path.quaternions, path.quaternions[:1]]),
    )
    mapped = MappedSequence(reef, "cam", {"away": away})
    true, failed = evaluate_maps(mapped, None, MapSettings(cell_m=0.5), align="none")
    assert (true.record.failure, "has the trajectory diverged" in failed.record.failure) == (None, True)
