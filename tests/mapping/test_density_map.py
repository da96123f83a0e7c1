"""Maps of oysters: each is counted once, where it lies, and what cannot be mapped is refused by name."""

from __future__ import annotations

import importlib.util
import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from oysterbench.core.errors import LabelError, OysterbenchError, SequenceError, TrajectoryError
from oysterbench.core.trajectory import write_tum
from oysterbench.mapping import MapSettings, Seen, build_map, read_seen, true_seen
from oysterbench.report.density_files import geotiffs, grid_rows, map_page, summary, write_map
from oysterbench.tracks.mapping_evaluation import TRUE_POSES, MappedSequence, evaluate_maps, map_count, true_map
from tests.helpers.flat_reef import BEGIN, BOTTOM, CAMERA, LANE, FlatReef, moved, scattered

DISCS = scattered(-1.2, 3.6)
SETTINGS = MapSettings(cell_m=0.5)


def map_of(reef, trajectory=None, settings=SETTINGS, seen=None, depth="layer", **options):
    trajectory = trajectory or reef.truth()
    return build_map(reef, trajectory, seen or (lambda: true_seen(reef, "cam")), "cam", depth, settings, **options)


@pytest.fixture(scope="module")
def once():
    return FlatReef(LANE, DISCS)


@pytest.fixture(scope="module")
def found(once):
    return map_of(once)


def test_with_true_poses_and_masks_the_count_is_within_three_percent():
    wide = FlatReef(np.concatenate([LANE, LANE[::-1] + np.array([0.0, 0.9])]), DISCS)
    truth, found = true_map(wide, "cam", SETTINGS), map_of(wide)
    assert truth.count.shown > 200
    assert found.total.count == pytest.approx(truth.count.shown, rel=0.03)
    assert found.total.live == pytest.approx(truth.count.live, rel=0.03)
    assert found.total.dead > 0


def test_each_oyster_is_one_entry_at_its_place(found):
    numbers = [{patch.number for patch in track.patches} for track in found.tracks]
    assert all(len(of_one) == 1 for of_one in numbers)
    assert len({min(of_one) for of_one in numbers}) == len(numbers)
    for track, (number,) in zip(found.tracks, numbers, strict=True):
        if track.whole:
            # A little off where most of it is cut in most pictures.
            assert np.linalg.norm(track.centre[:2] - DISCS.centres[number - 1]) < 0.012
            assert track.centre[2] == pytest.approx(BOTTOM, abs=1e-4)


def test_a_lane_flown_twice_counts_no_oyster_twice(found):
    again = map_of(FlatReef(np.concatenate([LANE, LANE[::-1] + 0.011]), DISCS))
    assert again.total.count == pytest.approx(found.total.count, rel=0.03)
    numbers = [min(patch.number for patch in track.patches) for track in again.tracks]
    assert len(set(numbers)) == len(numbers)


def test_a_second_pass_that_is_off_by_centimetres_counts_no_oyster_twice(found):
    twice = FlatReef(np.concatenate([LANE, LANE[::-1]]), DISCS)
    off = moved(twice.truth(), np.array([0.02, -0.015, 0.005]), slice(8, None))
    again = map_of(twice, off, replace(SETTINGS, pose_sigma_m=0.02))
    assert again.total.count == pytest.approx(found.total.count, rel=0.05)


def test_a_second_pass_that_is_off_by_a_metre_is_other_ground(found):
    twice = FlatReef(np.concatenate([LANE, LANE]), DISCS)
    off = moved(twice.truth(), np.array([0.0, 20.0, 0.0]), slice(8, None))
    again = map_of(twice, replace(off, stamps_ns=twice.stamps))
    assert again.total.count == pytest.approx(2 * found.total.count, rel=0.01)
    assert again.total.area_m2 == pytest.approx(2 * found.total.area_m2, rel=0.02)


def test_an_oyster_that_the_edge_always_cuts_counts_a_half():
    alone = replace(DISCS, centres=np.array([[0.0, 0.0], [0.0, 0.69]]), radii=np.full(2, 0.03), live=np.full(2, True))
    found = map_of(FlatReef(LANE[:1], alone))
    assert sorted(one.weight for one in found.oysters) == [0.5, 1.0]
    assert found.total.count == 1.5
    assert found.total.count_low < 1.5 < found.total.count_high


def test_a_rolling_shutter_lays_each_row_where_the_camera_was_then(found):
    # 0.2 s at 0.3 m/s: first and last rows are 3 cm away from where they would be at once.
    rolling = map_of(FlatReef(LANE, DISCS, camera=replace(CAMERA, readout_s=0.2)))
    assert rolling.total.count == pytest.approx(found.total.count, rel=0.03)
    inner = [track for track in rolling.tracks if track.whole and 0.3 < track.centre[0] < 1.8]
    assert len(inner) > 50
    for track in inner:
        assert np.linalg.norm(track.centre[:2] - DISCS.centres[track.patches[0].number - 1]) < 0.012


def test_pictures_that_are_stamped_late_lie_where_they_were_taken(found):
    late = FlatReef(LANE, DISCS, camera=replace(CAMERA, time_offset_s=0.2))
    taken = replace(late.truth(), stamps_ns=late.stamps - 200_000_000)
    places = [[one.centre for one in each.oysters] for each in (map_of(late, taken), found)]
    assert np.allclose(*places, atol=1e-3)


@pytest.mark.parametrize("depth", ["layer", "plane"])
def test_a_picture_that_repeats_the_one_before_shows_nothing_elsewhere(depth):
    places = np.insert(LANE, 4, LANE[3] + [0.12, 0.0], axis=0)
    seconds = np.insert(np.arange(8.0), 4, 3.4)
    once, repeated = (FlatReef(places, DISCS, seconds=seconds, repeats=these) for these in ((), (4,)))
    maps = [map_of(reef, depth=depth) for reef in (once, repeated)]
    assert maps[1].total.count == pytest.approx(maps[0].total.count, abs=1.0)
    numbers = [min(patch.number for patch in track.patches) for track in maps[1].tracks]
    assert len(set(numbers)) == len(numbers)
    assert true_map(repeated, "cam", SETTINGS).count.shown == pytest.approx(maps[1].total.count, rel=0.05)


def test_area_is_that_of_the_pictures(found):
    # 2.1 m of way under a picture of 120 x 160 px at 115 px a metre.
    assert found.total.area_m2 == pytest.approx((2.1 + 120 / 115) * 160 / 115, rel=0.02)


def test_cells_of_which_too_little_was_seen_have_no_number(found):
    grid = found.grid
    little = (grid.area_m2 > 0) & (grid.area_m2 < SETTINGS.least_cover * SETTINGS.cell_m**2)
    assert little.any()
    assert np.isnan(grid.density[little]).all()
    assert (grid.classes[little] == -1).all()
    assert np.isfinite(grid.density[grid.known]).all()
    assert (grid.low[grid.known] <= grid.density[grid.known]).all()
    assert (grid.high[grid.known] >= grid.density[grid.known]).all()


def test_the_bottom_as_a_plane_under_the_dvl_is_where_it_is(once, found):
    from_echoes = map_of(once, depth="plane")
    assert from_echoes.total.count == pytest.approx(found.total.count, rel=0.05)
    assert np.allclose([one.centre[2] for one in from_echoes.oysters], BOTTOM, atol=0.02)


def test_scores_take_a_map_of_the_truth_for_true(once):
    runs = {
        run.record.method: run.record.metrics
        for run in evaluate_maps(
            MappedSequence(once, "cam", {"turned": _turned(once.truth())}), None, SETTINGS, "layer"
        )
    }
    assert abs(runs[TRUE_POSES]["count_error_percent"]) < 5  # on so little ground, edges count
    assert runs[TRUE_POSES]["twice_percent"] == 0
    assert runs[TRUE_POSES]["coverage"] == 1
    # What differs by a turn and a shift is the same once it is aligned.
    assert runs["turned"]["count_error_percent"] == pytest.approx(runs[TRUE_POSES]["count_error_percent"], abs=1.5)
    assert runs["turned"]["cell_mae_per_m2"] == pytest.approx(runs[TRUE_POSES]["cell_mae_per_m2"], abs=0.5)


@pytest.mark.parametrize(
    ("aside", "shown"), [(0.0, 1), (0.6, 0)]
)  # whole in the middle of the picture, cut at its edge
def test_an_oyster_that_is_shown_whole_counts_where_relief_hides_the_ground_at_its_middle(aside, shown):
    class Hollow(FlatReef):
        def layer(self, camera, layer, start_ns=None, end_ns=None):
            for image in super().layer(camera, layer, start_ns, end_ns):
                middle = np.array([59.5, 79.5 + 115 * aside])
                hidden = np.hypot(*(np.indices(image.pixels.shape) - middle[:, None, None])) < 10
                yield replace(image, pixels=np.where(hidden, 0, image.pixels))

    one = replace(DISCS, centres=np.zeros((1, 2)), radii=np.array([0.2]), live=np.array([True]))
    truth = true_map(Hollow(np.array([[0.0, aside]]), one), "cam", SETTINGS)
    assert not truth.cover.holds(one.centres).any()
    assert truth.count.shown == shown


def test_a_path_that_cannot_be_mapped_is_a_failure_in_the_results(once):
    late = replace(once.truth(), stamps_ns=once.stamps + 10**12)
    runs = list(evaluate_maps(MappedSequence(once, "cam", {"late": late}), None, SETTINGS))
    assert [run.record.failure is None for run in runs] == [True, False]
    assert runs[1].record.metrics["map_score"] == 0


def test_entries_that_show_one_oyster_are_told(once, found):
    owners = {(p.frame, p.number): 1 for track in found.tracks for p in track.patches}
    count = map_count(found, owners)
    assert list(count.owners) == [1] * len(found.tracks)
    assert count.found == {1}


def _turned(trajectory):
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    half = np.sqrt(0.5)
    quaternions = np.tile([0.0, 0.0, half, half], (len(trajectory), 1))
    # One pose stands aside, so that a line does not leave the turn open.
    return replace(trajectory, positions=trajectory.positions @ turn.T + [5.0, 2.0, 1.0], quaternions=quaternions)


# Refusals.


def test_a_trajectory_of_another_time_is_refused(once):
    late = replace(once.truth(), stamps_ns=once.stamps + 10**12)
    with pytest.raises(TrajectoryError, match="overlap in time"):
        map_of(once, late)


def test_masks_of_another_sequence_are_refused_by_their_name(once, tmp_path):
    (tmp_path / "other" / "cam").mkdir(parents=True)
    cv2.imwrite(str(tmp_path / "other" / "cam" / f"{BEGIN}.png"), np.zeros((120, 160), np.uint8))
    with pytest.raises(LabelError, match="masks of another sequence: expected those of flat, got other"):
        map_of(once, seen=lambda: read_seen(tmp_path, once, "cam", "auto", 0.5))


def test_of_masks_of_several_sequences_those_of_the_others_are_left_out(once, tmp_path):
    for name, value in (("flat", 7), ("other", 9)):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / f"{BEGIN}.png"), np.full((120, 160), value, np.uint16))
    (seen,) = read_seen(tmp_path, once, "cam", "instances", 0.5, several=True)
    assert np.unique(seen.numbers).tolist() == [7]
    (tmp_path / f"{BEGIN}.png").write_bytes((tmp_path / "flat" / f"{BEGIN}.png").read_bytes())
    with pytest.raises(LabelError, match="expected the name of its sequence too"):
        list(read_seen(tmp_path, once, "cam", "instances", 0.5, several=True))


def test_masks_of_none_of_several_sequences_are_missed_by_name(once, tmp_path):
    (tmp_path / "other").mkdir()
    cv2.imwrite(str(tmp_path / "other" / f"{BEGIN}.png"), np.ones((120, 160), np.uint16))
    with pytest.raises(LabelError, match="no masks for cam of flat"):
        list(read_seen(tmp_path, once, "cam", "instances", 0.5, several=True))


def test_masks_of_another_sequence_are_refused_by_their_stamps(once):
    foreign = [Seen(BEGIN + 5, "cam", np.ones((120, 160), int))]
    with pytest.raises(LabelError, match="took no image at"):
        map_of(once, seen=lambda: foreign)


def test_masks_of_another_size_are_refused(once):
    with pytest.raises(LabelError, match="expected 160 x 120 px"):
        map_of(once, seen=lambda: [Seen(BEGIN, "cam", np.ones((60, 80), int))])


def test_no_depth_is_refused_with_what_there_is():
    bare = FlatReef(LANE, DISCS, layers=("class", "instance"))
    with pytest.raises(SequenceError, match="no layer depth"):
        map_of(bare)
    with pytest.raises(SequenceError, match="no other camera overlaps with"):
        map_of(bare, depth="stereo")
    bare.dvl_calibration = None
    with pytest.raises(SequenceError, match="neither DVL nor altimeter"):
        map_of(bare, depth="plane")


def test_an_unknown_camera_is_refused(once):
    with pytest.raises(SequenceError, match="no camera 'left'; its cameras: cam"):
        build_map(once, once.truth(), lambda: [], "left", "layer")


def test_settings_that_make_no_sense_are_refused():
    for wrong in ({"cell_m": 0.0}, {"least_cover": 2.0}, {"far_m": 0.1}, {"pose_sigma_m": -1.0}, {"cell_m": 0.02}):
        with pytest.raises(OysterbenchError, match=next(iter(wrong))):
            MapSettings(**wrong)


# Files.


def test_masks_from_files_give_the_map_of_the_same_masks(once, found, tmp_path):
    folder = tmp_path / "flat" / "cam"
    folder.mkdir(parents=True)
    for k, stamp in enumerate(once.stamps):
        cv2.imwrite(str(folder / f"{stamp}.png"), once.numbers(k).astype(np.uint16))
    read = map_of(once, seen=lambda: read_seen(tmp_path, once, "cam", "instances", 0.5))
    assert read.total.count == found.total.count
    assert read.total.unknown == read.total.count
    guessed = map_of(once, seen=lambda: read_seen(tmp_path, once, "cam", "auto", 0.5))
    assert repr(guessed.total) == repr(read.total)  # not equal from Python 3.13 on, as NaNs differ
    # Of which none is known to be alive, none is called so.
    page = map_page(read, "")
    assert not any(words in page for words in ("Live per m", "Live oysters", "15 live per"))
    assert all(words in page for words in ("Live or dead, per m", "oysters, live or dead unknown, per m"))
    assert not summary(read)["states_known"]
    assert summary(found)["states_known"]
    for one, has, lacks in ((read, "oysters_per_m2", "live_per_m2"), (found, "live_per_m2", "oysters_per_m2")):
        for names in (summary(one), next(iter(grid_rows(one)))):
            assert has in names
            assert lacks not in names
        density = geotiffs(one, np.zeros((*one.cover.views.shape, 4), dtype=np.uint8))["density.tif"]
        assert has.encode() in density
        assert lacks.encode() not in density
    for k, stamp in enumerate(once.stamps):
        cv2.imwrite(str(folder / f"{stamp}.png"), ((once.numbers(k) > 0) * 255).astype(np.uint8))
    cut = map_of(once, seen=lambda: read_seen(tmp_path, once, "cam", "mask", 0.5))
    assert cut.total.count == pytest.approx(found.total.count, rel=0.05)


def test_annotations_tell_live_from_dead(once, tmp_path):
    square = [40, 40, 60, 40, 60, 60, 40, 60]
    other = [value + 40 for value in square]
    document = {
        "images": [{"id": 1, "file_name": f"cam_{BEGIN}.png", "width": 160, "height": 120}],
        "categories": [{"id": 1, "name": "live"}, {"id": 2, "name": "dead"}],
        "annotations": [
            {"id": 1, "image_id": 1, "category_id": 1, "segmentation": [square]},
            {"id": 2, "image_id": 1, "category_id": 2, "segmentation": [other]},
        ],
    }
    (tmp_path / "a.json").write_text(json.dumps(document))
    found = map_of(once, seen=lambda: read_seen(tmp_path / "a.json", once, "cam", "auto", 0.5))
    assert (found.total.live, found.total.dead, found.total.unknown) == (1, 1, 0)
    document["categories"] += [{"id": 3, "name": "oyster"}, {"id": 4, "name": "rock"}]  # a map is of oysters alone
    (tmp_path / "a.json").write_text(json.dumps(document))
    (seen,) = read_seen(tmp_path / "a.json", once, "cam", "auto", 0.5)
    assert seen.states == {1: "live", 2: "dead"}
    # As `oysterbench segment` says it: one category, and how likely an oyster is alive.
    document["categories"] = [{"id": 1, "name": "oyster"}]
    for annotation, live in zip(document["annotations"], (0.9, 0.2), strict=True):
        annotation |= {"category_id": 1, "live": live}
    (tmp_path / "a.json").write_text(json.dumps(document))
    found = map_of(once, seen=lambda: read_seen(tmp_path / "a.json", once, "cam", "auto", 0.5))
    assert (found.total.live, found.total.dead, found.total.unknown) == (1, 1, 0)
    for annotation, state in zip(document["annotations"], ("Dead", "unknown"), strict=True):
        annotation["state"] = state
    (tmp_path / "a.json").write_text(json.dumps(document))
    (seen,) = read_seen(tmp_path / "a.json", once, "cam", "auto", 0.5)
    assert seen.states == {1: "dead", 2: "unknown"}
    document["annotations"][0]["state"] = "live"
    document["annotations"][1] |= {"live": None, "state": None}
    (tmp_path / "a.json").write_text(json.dumps(document))
    (seen,) = read_seen(tmp_path / "a.json", once, "cam", "auto", 0.5)
    assert seen.states == {1: "live", 2: "unknown"}
    document["annotations"][0]["score"] = "high"
    (tmp_path / "a.json").write_text(json.dumps(document))
    with pytest.raises(LabelError, match=r"annotations\[0\]: expected 'score', a number, got high"):
        list(read_seen(tmp_path / "a.json", once, "cam", "auto", 0.5))


@pytest.fixture(scope="module")
def written(found, tmp_path_factory):
    """The files of the map, by their names."""
    return {path.name: path for path in write_map(found, tmp_path_factory.mktemp("written") / "map")}


def test_what_is_written_says_what_was_found(found, written):
    facts = json.loads(written["summary.json"].read_text())
    assert facts["oysters"]["count"] == found.total.count
    rows = written["grid.csv"].read_text().splitlines()
    head = rows[0].split(",")
    cells = [dict(zip(head, row.split(","), strict=True)) for row in rows[1:]]
    assert sum(float(cell["live"]) + float(cell["dead"]) for cell in cells) == found.total.count
    assert any(cell["live_per_m2"] == "" for cell in cells)
    # The world file puts an oyster's place on a pixel that was seen.
    size, _, _, minus, west, north = map(float, written["density.pgw"].read_text().split())
    pixels = cv2.imread(str(written["mosaic.png"]), cv2.IMREAD_UNCHANGED)
    x, y = found.oysters[0].centre[:2]
    assert pixels[round((y - north) / minus), round((x - west) / size), 3] == 255
    figure = cv2.imread(str(written["map.png"]))
    assert figure.std() > 20
    assert "<svg" in written["map.html"].read_text()


def test_the_same_input_gives_the_same_bytes(once, written, tmp_path):
    again = write_map(map_of(once), tmp_path / "again")
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in written.values()]


def test_a_trajectory_file_is_as_good_as_its_poses(once, found, tmp_path):
    from oysterbench.core.trajectory import read_trajectory

    write_tum(tmp_path / "poses.tum", once.truth())
    assert map_of(once, read_trajectory(tmp_path / "poses.tum")).total.count == found.total.count


def test_geotiffs_lie_where_the_grid_does_and_hold_its_numbers(found, written):
    tifffile = pytest.importorskip("tifffile", reason="needs tifffile: pip install 'oysterbench[maps]'")
    with tifffile.TiffFile(written["density.tif"]) as file:
        density, low, high, seen = file.asarray()
        keys = file.geotiff_metadata
    grid = found.grid
    assert np.array_equal(density, grid.density.astype(np.float32), equal_nan=True)
    assert (low[grid.known] <= density[grid.known]).all()
    assert (density[grid.known] <= high[grid.known]).all()
    assert np.nansum(seen) == pytest.approx(found.total.area_m2, rel=1e-6)
    assert keys["ModelPixelScale"][:2] == [grid.cell_m, grid.cell_m]
    assert keys["ModelTiepoint"][3:5] == [grid.west_m, grid.north_m]
    assert keys["GTModelTypeGeoKey"] == 32767, "of no register: nobody knows where on the Earth"
    assert "local frame of the path of flat" in keys["GTCitationGeoKey"]
    with tifffile.TiffFile(written["mosaic.tif"]) as file:
        colours, keys = file.asarray(), file.geotiff_metadata
    x, y = found.oysters[0].centre[:2]
    (edge, _, _), (_, _, _, west, north, _) = keys["ModelPixelScale"], keys["ModelTiepoint"]
    assert colours[int((north - y) / edge), int((x - west) / edge), 3] == 255


def test_without_tifffile_a_map_has_its_other_files(found, tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *of: find(name, *of) if name != "tifffile" else None)
    names = {path.name for path in write_map(found, tmp_path)}
    assert not any(name.endswith(".tif") for name in names)
    page = (tmp_path / "map.html").read_text()
    links = set(re.findall(r'<a href="([^"]+)"', page))
    assert links <= names
    assert {"grid.csv", "mosaic.png"} <= links
