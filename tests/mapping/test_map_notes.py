"""What a map says about its input: images without oysters, without masks, without poses."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from oysterbench.core.errors import SequenceError, TrajectoryError
from oysterbench.core.trajectory import Trajectory
from oysterbench.mapping import Seen, true_seen
from oysterbench.mapping.survey import _unmasked
from oysterbench.mapping.views import begin_ns, check_time, check_upright
from oysterbench.report.density_files import map_page, summary
from oysterbench.sequence import open_sequence
from oysterbench.sequence.cut import cut_to
from tests.helpers.flat_reef import LANE, FlatReef, scattered
from tests.mapping.test_density_map import SETTINGS, map_of

WIDE = replace(SETTINGS, max_gap_s=1.0)


@pytest.fixture(scope="module")
def reef():
    return FlatReef(LANE, scattered(-0.6, 1.2))


def test_ground_without_oysters_has_a_density_of_zero_with_an_interval_and_that_is_said(reef):
    found = map_of(reef, seen=lambda: [Seen(int(stamp), "cam", np.zeros((120, 160), int)) for stamp in reef.stamps])
    total = found.total
    assert (total.count, total.live_per_m2, total.low_per_m2) == (0.0, 0.0, 0.0)
    # Of none counted, the mean may be up to 3.7 (Poisson, 97.5 %).
    assert total.high_per_m2 == pytest.approx(3.689 / total.area_m2, rel=1e-3)
    (note,) = [note for note in found.notes if "no oyster" in note]
    assert "no oyster in any of 8 masks" in note
    assert "--threshold" in note
    assert "No oyster in any of 8 masks" in map_page(found, "")
    assert summary(found)["oysters"]["count"] == 0


def test_labelled_images_without_a_mask_are_counted(reef):
    half = list(true_seen(reef, "cam"))[::2]
    (note,) = [note for note in map_of(reef, seen=lambda: half).notes if "mask" in note]
    assert note.startswith("4 of 8 labelled images have no mask and are left out")
    assert not any("mask" in note for note in map_of(reef).notes)


def test_images_of_an_own_dive_without_a_mask_are_counted(reef):
    dive = FlatReef(LANE, reef.discs, layers=("depth", "instance"))
    masks = list(true_seen(reef, "cam"))
    (note,) = [note for note in map_of(dive, seen=lambda: masks[::2]).notes if "mask" in note]
    assert note.startswith("4 of 8 images have no mask and are left out; an image without oysters needs an empty mask")
    assert not any("mask" in note for note in map_of(dive, seen=lambda: masks).notes)


def test_images_without_a_mask_are_counted_by_the_names_of_topics_and_of_folders(reef):
    def said(given, **counts):
        named = SimpleNamespace(contents=lambda: [(name.replace("_", "/"), "", n) for name, n in counts.items()])
        return _unmasked(named, "cam0", given)

    assert said(24, cam0=81, cam1=90, imu0=2000) == "57 of 81 images"
    assert said(81, cam0=81) == ""
    assert said(30, _cam0_image=200, _cam0_class=40) == "10 of 40 labelled images"
    assert said(40, _cam0_image=200, _cam0_class=40) == ""
    assert said(150, _cam0_image=200, _cam0_class=40) == "50 of 200 images"


def test_images_without_a_pose_are_counted_with_the_reason(reef):
    sparse = reef.truth().select(np.array([0, 2, 3, 6]))
    (note,) = [note for note in map_of(reef, sparse).notes if "pose" in note]
    assert note.startswith("4 of 8 images have no pose and are left out: 3 between poses more than 0.3 s apart (--max")
    assert note.endswith(", 1 before or after the path")
    (note,) = [note for note in map_of(reef, sparse, replace(SETTINGS, max_gap_s=2.0)).notes if "pose" in note]
    assert note.startswith("3 of 8 images have no pose and are left out: 2 between poses more than 2 s apart")


def test_a_path_without_a_pose_at_any_image_is_refused_with_the_reason(reef):
    between = replace(reef.truth(), stamps_ns=reef.stamps + 500_000_000)
    with pytest.raises(TrajectoryError, match=r"at any of 8 images .*: 7 between poses more than 0\.3 s apart"):
        map_of(reef, between)
    assert len(map_of(reef, between, WIDE).path) == 7


class WithoutImu(FlatReef):
    """Has the topics of its camera only."""

    def imu(self, start_ns=None, end_ns=None):
        raise SequenceError("it has some of the topics only")


def test_a_map_needs_no_inertial_measurements(reef):
    alone = WithoutImu(LANE, reef.discs)
    assert not alone.has_imu
    check_upright(alone, alone.truth())
    assert map_of(alone).total.count == map_of(reef).total.count
    late = replace(alone.truth(), stamps_ns=alone.truth().stamps_ns + 10**12)
    with pytest.raises(TrajectoryError, match=r"from 1000000000\.000 to .* do not overlap in time"):
        map_of(alone, late)


DVL = ("/dvl/velocity", "/dvl/beams", "/dvl/altitude")


@pytest.mark.parametrize("topics", [("/cam_left/class", "/cam_right/image"), DVL, (DVL[0], "/alt/range")])
def test_a_map_begins_with_what_its_file_has_all_topics_of(dive_file, tmp_path, topics):
    cut_to(tmp_path / "some.mcap", dive_file, ["/truth/odometry", *topics])
    some = open_sequence(tmp_path / "some.mcap")
    first = next(some.measurements(topics[-1].split("/")[1])).stamp_ns
    assert begin_ns(some) == begin_ns(some.for_method()) == first
    check_time(some, some.truth())


def test_a_file_without_all_topics_of_any_sensor_is_refused(dive_file, tmp_path):
    cut_to(tmp_path / "some.mcap", dive_file, ["/truth/odometry", DVL[0], "/cam_left/class"])
    with pytest.raises(SequenceError, match="has all topics of no sensor: expected those of one or more for a map"):
        begin_ns(open_sequence(tmp_path / "some.mcap"))


def transit(path, metres):
    """The path, after which the vehicle leaves at 45 degrees."""
    away = path.positions[-1] + np.array([metres, metres, 0.0])
    return Trajectory(
        np.append(path.stamps_ns, path.stamps_ns[-1] + 10**11),
        np.vstack([path.positions, away]),
        np.vstack([path.quaternions, path.quaternions[-1:]]),
    )


def test_a_transit_without_images_changes_no_map(reef):
    found, alone = map_of(reef, transit(reef.truth(), 1e4)), map_of(reef)
    assert found.total.count == pytest.approx(alone.total.count, abs=0.5)
    assert found.total.area_m2 == pytest.approx(alone.total.area_m2, rel=1e-3)
    assert found.cover.raster.edge_m == alone.cover.raster.edge_m
    assert not any("squares of" in note for note in found.notes)


@pytest.mark.parametrize(("metres", "edge_cm"), [(120.0, "2"), (240.0, "4.2"), (420.0, "8.3")])
def test_images_far_apart_are_mapped_in_larger_squares_and_that_is_said(reef, metres, edge_cm):
    far = FlatReef(np.vstack([LANE, LANE + metres]), reef.discs)
    found, alone = map_of(far), map_of(reef)
    (note,) = [note for note in found.notes if "squares of" in note]
    assert note == f"the ground is measured in squares of {edge_cm} cm instead of 1 cm, as the images lie far apart"
    assert found.total.area_m2 == pytest.approx(2 * alone.total.area_m2, rel=0.005)
    assert found.total.live_per_m2 == pytest.approx(0.5 * alone.total.live_per_m2, rel=0.02)


def test_images_too_far_apart_for_small_cells_are_mapped_in_the_larger_ones_that_are_named(reef):
    far = FlatReef(np.vstack([LANE, LANE + 420.0]), reef.discs)
    with pytest.raises(TrajectoryError, match=r"0\.0375 m; larger cells .* larger squares: --cell 0\.5 maps it$"):
        map_of(far, settings=replace(SETTINGS, cell_m=0.3))
    assert map_of(far, settings=replace(SETTINGS, cell_m=0.5)).total.count > 0
    with pytest.raises(TrajectoryError, match="has the trajectory diverged"):
        map_of(FlatReef(np.vstack([LANE, LANE + 5e3]), reef.discs), settings=replace(SETTINGS, cell_m=0.3))


def test_images_too_far_apart_for_any_map_are_refused(reef):
    with pytest.raises(TrajectoryError, match="has the trajectory diverged"):
        map_of(FlatReef(np.vstack([LANE, LANE + 5e3]), reef.discs))


def test_a_map_without_ground_truth_needs_none(reef):
    class WithoutTruth(FlatReef):
        def contents(self):
            return [one for one in super().contents() if one[0] != "/truth/odometry"]

        def truth(self):
            raise SequenceError("it has none")

    masks = list(true_seen(reef, "cam"))
    found = map_of(WithoutTruth(LANE, reef.discs), reef.truth(), seen=lambda: masks)
    assert found.unassociated is not None, "nobody knows whether the path is exact"


def test_how_few_states_are_known_is_said(reef):
    masks = list(true_seen(reef, "cam"))
    only_dead = [replace(one, states={k: state for k, state in one.states.items() if state == "dead"}) for one in masks]
    found = map_of(reef, seen=lambda: only_dead)
    (note,) = [note for note in found.notes if "unknown state" in note]
    assert "count as 100 % live (95 %: 0 to 100 %), as all the known ones are dead, which says nothing of" in note
    assert found.total.low_per_m2 == 0.0 < found.total.live_per_m2
    assert not any("unknown state" in note for note in map_of(reef).notes)


def test_of_little_ground_the_page_says_what_its_interval_is_of(reef):
    found = map_of(reef)
    page = map_page(found, "")
    assert "95 % for the seen ground alone, as too little was seen to tell of the reef" in page
    assert "is that of the seen ground alone: too little was seen" in page
    assert summary(found)["live_per_m2"]["interval_of"] == "seen ground"
