"""Repeated and lost frames: poses, flow, clouds and maps are of the time when the images were taken."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

import oysterbench
from oysterbench.core.ros import EPOCH_NS
from oysterbench.recipe import parse_split
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.export.ply import camera_cloud
from oysterbench.sequence.export.steps import Steps
from oysterbench.simulation.generate import generate_split
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

LAYERS = 'layer_rate_hz = 10.0\nlayers = ["depth", "class", "instance", "flow"]'
FROZEN = "repeats = 0.4\ndropout = 0.2\nclock_offset_ms = 30.0\nclock_jitter_ms = 10.0"
BASE, _, CAMERA = TINY_RIG.replace("pitch_deg = 30.0", "pitch_deg = 60.0").partition("[[camera]]")
STEADY = CAMERA.replace("layer_rate_hz = 2.0", LAYERS)
RIG = f"{BASE}[[camera]]{STEADY}{FROZEN}\n[[camera]]{STEADY.replace('cam_front', 'steady')}"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A dive with two cameras at one place, of which one repeats and loses frames, by a clock of its own."""
    split = parse_split(TINY_SPLIT.replace("oysters = 60", "oysters = 900"), "tiny.toml", RIG)
    return generate_split(split, tmp_path_factory.mktemp("frozen"))["tiny-01"]


@pytest.fixture(scope="module")
def sequence(path):
    return oysterbench.open(path)


@pytest.fixture(scope="module")
def steady(sequence):
    """Layer -> its images by the camera that takes them all."""
    return {name: [image.pixels for image in sequence.layer("steady", name)] for name in ("depth", "flow")}


def taken(sequence, camera="cam_front"):
    """Number of the image that each frame in the file shows, by the true calibration."""
    calibration = sequence.truly_calibrated().cameras[camera]
    times = [calibration.taken_ns(image.stamp_ns) - EPOCH_NS for image in sequence.images(camera)]
    assert all(time % 100_000_000 == 0 for time in times), "no jitter is left, and no offset"
    return [time // 100_000_000 for time in times]


def test_the_true_calibration_knows_when_the_image_of_a_frame_was_taken(sequence, steady):
    shown = taken(sequence)
    assert taken(sequence, "steady") == list(range(25))
    assert len(set(shown)) < len(shown) < 25
    for number, depth in zip(shown, sequence.layer("cam_front", "depth"), strict=True):
        assert np.array_equal(depth.pixels, steady["depth"][number])


def test_flow_leads_to_the_image_of_the_next_frame_in_the_file(sequence, steady):
    shown, flows = taken(sequence), [image.pixels for image in sequence.layer("cam_front", "flow")]
    kinds = set()
    for flow, now, after in zip(flows, shown, shown[1:], strict=False):
        kinds.add(min(after - now, 2))
        known = np.isfinite(flow)
        if after == now:
            assert not flow[known].any()
        elif after == now + 1:
            assert np.array_equal(flow, steady["flow"][now], equal_nan=True)
        else:
            assert np.median(np.abs(flow[known])) > 1.5 * np.nanmedian(np.abs(steady["flow"][now]))
    assert kinds == {0, 1, 2}
    assert np.isnan(flows[-1]).all()
    assert np.isnan(steady["flow"][-1]).all()


def test_windows_have_the_pose_of_the_image_that_a_frame_repeats(path, sequence):
    windows = oysterbench.torch.WindowDataset(path, length=2, camera="cam_front")
    shown, truth = taken(sequence), sequence.truth()
    for k, item in enumerate(windows):
        times = EPOCH_NS + 100_000_000 * np.array(shown[k : k + 2])
        assert item["taken_ns"].tolist() == times.tolist()
        assert item["pose"].numpy() == pytest.approx(truth.at(times).matrices, abs=1e-9)
        assert (item["relative_pose"][0].numpy() == pytest.approx(np.eye(4), abs=1e-7)) == (shown[k] == shown[k + 1])


def test_kitti_has_every_frame_at_the_pose_of_its_image(sequence, tmp_path):
    folder, _ = export_sequence(sequence, "kitti", tmp_path / "kitti")
    places = np.loadtxt(folder / "poses" / "00.txt").reshape(-1, 3, 4)[:, :, 3]
    shown = np.array(taken(sequence))
    assert len(places) == len(list((folder / "sequences/00/image_0").iterdir())) == len(shown)
    still = np.linalg.norm(np.diff(places, axis=0), axis=1) < 1e-9
    assert still.tolist() == (np.diff(shown) == 0).tolist()


def test_a_cloud_has_no_points_that_the_steady_camera_does_not_see(sequence):
    true, truth = sequence.truly_calibrated(), sequence.truth()
    topics = {topic for topic, _, _ in sequence.contents()}
    clouds = [camera_cloud(true, name, truth, topics, Steps()) for name in ("cam_front", "steady")]
    found, wanted = (np.column_stack([cloud[axis] for axis in "xyz"]).astype(float) for cloud in clouds)
    nearest, _ = cKDTree(wanted).query(found)
    assert np.percentile(nearest, 99) < 0.02
    assert 0 < len(found) < len(wanted)


def test_a_map_of_true_masks_has_oysters_where_the_steady_camera_sees_them(sequence):
    maps = [
        oysterbench.oyster_map(sequence, sequence.truth(), camera=camera, depth="layer", least_px=8)
        for camera in ("cam_front", "steady")
    ]
    found, wanted = (one.table()[["x_m", "y_m", "z_m"]].to_numpy() for one in maps)
    assert cKDTree(wanted).query(found)[0].max() < 0.01
    assert 0.8 * maps[1].total.count < maps[0].total.count <= maps[1].total.count
