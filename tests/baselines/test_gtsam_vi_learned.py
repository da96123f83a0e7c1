"""The learned front end: what the network gives, what it is taught by, and what a user sees."""

from __future__ import annotations

import dataclasses
import json

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from click.testing import CliRunner  # noqa: E402
from scipy.ndimage import fourier_shift  # noqa: E402

from oysterbench.core.errors import LabelError, MethodError  # noqa: E402
from oysterbench.core.streams import Streams, stream  # noqa: E402
from oysterbench.methods import find_method  # noqa: E402
from oysterbench.sequence import open_sequence  # noqa: E402
from oysterbench.sequence.types import CameraCalibration  # noqa: E402
from oysterbench_baselines.gtsam_vi.pictures import even_contrast, without_veil  # noqa: E402
from oysterbench_baselines.gtsam_vi.settings import FrontEndSettings  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned import (  # noqa: E402
    GtsamViLearned,
    GtsamViLearnedSettings,
    correspondence,
)
from oysterbench_baselines.gtsam_vi_learned.command import command  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.correspondence import Footage, read_footage  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.disturbances import Disturbances, disturbed  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.frontend import LearnedFrontEnd  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.lens import TrueLens  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.lucas_kanade import TrackingSettings, pyramid, sample, track  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.model import MapModel  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.network import MapNetwork, MapNetworkSettings  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.pairs import Pairs, PairSettings  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.settings import LearnedSettings  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.training import MapTrainingSettings, train  # noqa: E402
from oysterbench_baselines.learning.card import describe  # noqa: E402
from oysterbench_baselines.learning.checkpoint import read_checkpoint  # noqa: E402
from tests.helpers import synthetic_dive as dive  # noqa: E402
from tests.helpers.weights_made import card_of  # noqa: E402

NETWORK = MapNetworkSettings(channels=(4, 8, 8))
PAIRS = PairSettings(crop=40, border=4, points=16, margin=3, start_px=1.0, most_s=0.25, least_points=4)
SMALL = MapTrainingSettings(
    batch=2, tracked=8, network=NETWORK, tracking=TrackingSettings(reach=6, levels=2), pairs=PAIRS
)


QUIET = dataclasses.replace(PAIRS, disturbances=Disturbances(plume=0.2, coding=0.0))


def small(steps: int, **changes) -> MapTrainingSettings:
    fit = dataclasses.replace(SMALL.fit, steps=steps, warm_up=2, learning_rate=3e-3)
    return dataclasses.replace(SMALL, fit=fit, **changes)


def texture(seed: int = 0, shape: tuple[int, int] = (480, 640)) -> np.ndarray:
    noise = stream(seed, b"", "texture").normal(size=shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5) * 3 + cv2.GaussianBlur(noise, (0, 0), 5) * 5
    return np.clip(110 + 40 * smooth, 0, 255).astype(np.uint8)


def shifted(picture: np.ndarray, by: tuple[float, float]) -> np.ndarray:
    """Exactly, away from the border: OpenCV's warps know only thirty-seconds of a pixel."""
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(picture.astype(float)), by[::-1])).real
    return np.clip(np.round(moved), 0, 255).astype(np.uint8)


def model(settings: MapNetworkSettings = NETWORK) -> MapModel:
    torch.manual_seed(0)
    return MapModel(MapNetwork(settings))


@pytest.fixture(scope="module")
def footage(tiny_file):
    return Footage(tiny_file)


# The network


def test_the_network_gives_maps_of_the_pictures_size_and_errors_at_a_quarter_of_it():
    maps, log_error = MapNetwork(NETWORK)(torch.zeros(2, 1, 48, 64))
    assert maps.shape == (2, 3, 48, 64)
    assert log_error.shape == (2, 1, 12, 16)
    assert sum(p.numel() for p in MapNetwork(MapNetworkSettings()).parameters()) < 300_000


@pytest.mark.parametrize("size", [(480, 640), (61, 83)])
def test_pictures_of_any_size_have_maps_of_theirs(size):
    found = model()(texture(0, size))
    assert found.maps.shape == (*size, 3)
    assert found.maps.dtype == np.uint8
    assert found.error_px.shape == size
    assert (found.error_px > 0).all()
    alone = model()(texture(0, size), with_maps=False)
    assert alone.maps is None
    assert np.allclose(alone.error_px, found.error_px, rtol=1e-5)


def test_an_untrained_networks_first_map_is_almost_the_picture():
    picture = even_contrast(without_veil(texture(), FrontEndSettings()), FrontEndSettings())
    first = model()(picture).maps[..., 0]
    assert np.corrcoef(first.ravel(), picture.ravel())[0, 1] > 0.95


# Tracking


def test_a_shift_is_tracked_to_a_fiftieth_of_a_pixel_through_the_tracking_that_is_learnt_through():
    picture, by = texture(1, (120, 160)), (1.3, -0.7)
    before, after = (
        torch.from_numpy(one.astype(np.float32) / 40)[None, None] for one in (picture, shifted(picture, by))
    )
    points = torch.tensor([[[40.0, 40.0], [80.0, 60.0], [120.0, 80.0]]])
    ends = track(before, after, points, points, TrackingSettings(iterations=8))
    assert len(ends) == 8
    assert torch.allclose(ends[-1], points + torch.tensor(by), atol=0.02)


def test_a_level_of_the_pyramid_has_every_second_pixel_in_its_place():
    x = torch.arange(32.0).expand(1, 1, 24, 32)
    half = pyramid(x, 2)[1]
    assert half.shape == (1, 1, 12, 16)
    assert torch.allclose(half[0, 0, 4:8, 4:12], 2 * torch.arange(4.0, 12.0).expand(4, 8))
    assert float(sample(x, torch.tensor([[[7.25, 3.0]]]))) == pytest.approx(7.25)


@pytest.mark.parametrize("maps", [True, False])
def test_the_front_end_follows_a_shift_of_the_picture_to_a_tenth_of_a_pixel(maps):
    settings = GtsamViLearnedSettings(learned=LearnedSettings(maps=maps))
    front_end = LearnedFrontEnd(dive.camera_calibration(), settings, model())
    picture, by = texture(), (3.4, -2.2)
    before = front_end.track(picture, np.eye(3))
    after = front_end.track(shifted(picture, by), np.eye(3))
    _, a, b = np.intersect1d(before.ids, after.ids, return_indices=True)
    error = np.linalg.norm(after.pixels[b] - before.pixels[a] - by, axis=1)
    assert len(a) > 0.8 * len(before.ids)
    assert np.median(error) < 0.1


def test_no_track_begins_or_goes_on_where_the_network_expects_errors():
    front_end = LearnedFrontEnd(dive.camera_calibration(), GtsamViLearnedSettings(), model())
    limit = front_end.learned.max_error_px
    make = front_end.model.__call__

    class Doubtful:
        def __call__(self, even, with_maps):
            seen = make(even, with_maps)
            error = np.where(np.arange(even.shape[1]) < 320, limit + 1, 0.5) * np.ones(even.shape)
            return dataclasses.replace(seen, error_px=error.astype(np.float32))

    front_end.model = Doubtful()
    picture = texture()
    first = front_end.track(picture, np.eye(3))
    assert len(first.ids) > 20
    assert (first.pixels[:, 0] >= 320).all()
    second = front_end.track(shifted(picture, (-8.0, 0.0)), np.eye(3))
    assert (second.pixels[:, 0] >= 319.5).all()


# What it is taught by


def test_rays_behind_a_flat_port_are_bent_and_found_again():
    plain = dive.camera_calibration()
    lens = TrueLens(dataclasses.replace(plain, port_m=0.01, port_index=1.33))
    pixels, depths = np.array([[30.0, 50.0], [319.5, 239.5], [600.0, 400.0]]), np.array([0.6, 1.0, 2.0])
    points = lens.points(pixels, depths)
    assert points[:, 2] == pytest.approx(depths)
    assert lens.pixels(points) == pytest.approx(pixels, abs=0.01)
    flat = (pixels[0] - plain.matrix[:2, 2]) / plain.matrix[0, 0]  # Snell's law, by hand
    tangent = np.linalg.norm(flat)
    in_water = np.arcsin(np.sin(np.arctan(tangent)) / 1.33)
    assert np.linalg.norm(points[0, :2]) == pytest.approx(0.01 * tangent + 0.59 * np.tan(in_water))


def test_each_picture_is_learned_from_once_as_of_when_it_was_taken(tiny_file, monkeypatch):
    sequence = open_sequence(tiny_file)
    stamps = [image.stamp_ns for image in sequence.images("cam_front")]
    lost = stamps[2] + 50_000_000  # a picture whose own frame was lost, so that only those that repeat it show it
    shown = [stamps[0], stamps[0], stamps[2], lost, lost, *stamps[5:]]
    rows = "".join(f"cam_front,{one},{other}\n" for one, other in zip(stamps, shown, strict=True))
    table = {"truth/frames.csv": f"camera,stamp_ns,shown_ns\n{rows}".encode()}
    monkeypatch.setattr(sequence, "attachments", {**sequence.attachments, **table})
    monkeypatch.setattr(correspondence, "open_sequence", lambda path: sequence)
    assert Footage(tiny_file).taken_ns.tolist() == [stamps[0], stamps[2], lost, *stamps[5:]]


def test_points_of_a_rendered_picture_are_found_in_the_next_where_the_truth_says(footage):
    """Lucas and Kanade, begun at the truth, stays there."""
    anchor = footage.anchors[1]
    picture, other = footage.pictures[anchor.picture], footage.pictures[anchor.picture + 1]
    corners = cv2.goodFeaturesToTrack(picture, 40, 0.01, 3).reshape(-1, 2)
    corners = np.round(corners[((corners > 8) & (corners < [55, 39])).all(axis=1)])
    ends, known = footage.warp(anchor, anchor.picture + 1, corners)
    start, guess = (np.ascontiguousarray(one[known], dtype=np.float32) for one in (corners, ends))
    assert len(start) > 8
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        picture, other, start, guess.copy(), winSize=(11, 11), maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    assert good.sum() > 8
    assert np.median(np.linalg.norm(found - guess, axis=1)) < 0.3
    assert np.median(np.linalg.norm(guess - start, axis=1)) > 0.5


def test_a_pair_shows_the_same_at_the_points_it_names(footage):
    """Without disturbances, patches about a point and its target are alike."""
    quiet = Disturbances(plume=0, caustics=0, snow=0, noise=0, blur=0, gain=0, coding=0)
    pairs = Pairs([footage], dataclasses.replace(PAIRS, disturbances=quiet))
    before, after, points, targets, starts, off, known = pairs.batch(Streams(0), 0, 8)
    assert before.shape == after.shape == (8, 1, 40, 40)
    assert points.shape == targets.shape == starts.shape == (8, 16, 2)
    assert off.shape == known.shape == (8, 16)
    there, here = (sample(maps, where)[:, 0] for maps, where in ((before, points), (after, targets)))
    assert known.sum() > 40
    assert off[known > 0].median() < 1.0  # px, as they are tracked
    chosen = known > 0
    assert np.corrcoef(there[chosen].numpy(), here[chosen].numpy())[0, 1] > 0.7


def test_pairs_depend_on_seed_and_step_alone(footage):
    pairs = Pairs([footage], PAIRS)
    one, same, other = (pairs.batch(Streams(0), step, 2) for step in (3, 3, 4))
    assert all(torch.equal(a, b) for a, b in zip(one, same, strict=True))
    assert not torch.equal(one[0], other[0])


def test_disturbances_change_a_picture_and_keep_its_kind():
    picture = texture(0, (96, 128))
    always = Disturbances(plume=1, caustics=1, snow=1, noise=1, blur=1, coding=1)
    found = disturbed(picture, always, stream(0, b"", "test"))
    assert found.shape == picture.shape
    assert found.dtype == np.uint8
    assert np.abs(found.astype(int) - picture).mean() > 3
    never = Disturbances(plume=0, caustics=0, snow=0, noise=0, blur=0, gain=0, coding=0)
    assert np.array_equal(disturbed(picture, never, stream(0, b"", "test")), picture)


def test_nothing_to_learn_from_is_said(footage):
    with pytest.raises(LabelError, match="tiny-01: expected images with depth to learn tracking from, got none"):
        Pairs([footage], dataclasses.replace(PAIRS, most_s=0.0))


# Training


@pytest.mark.slow
def test_a_short_training_lowers_the_loss(footage, tmp_path):
    found = train([footage], tmp_path / "one.pt", small(30, pairs=QUIET), 0)
    assert np.mean(found.losses[-10:]) < np.mean(found.losses[:10]) - 0.2


@pytest.mark.slow
def test_a_training_that_was_killed_goes_on_to_the_same_weights(footage, tmp_path, monkeypatch):
    whole = train([footage], tmp_path / "whole.pt", small(30, pairs=QUIET), 0)
    monkeypatch.setattr("oysterbench_baselines.learning.loop.KEEP_S", 0.0)

    class Killed(Exception):
        pass

    def kill(done: int, total: int) -> None:
        if done == 16:
            raise Killed

    with pytest.raises(Killed):
        train([footage], tmp_path / "half.pt", small(30, pairs=QUIET), 0, kill)
    assert not read_checkpoint(tmp_path / "half.pt").finished
    resumed = train([footage], tmp_path / "half.pt", small(30, pairs=QUIET), 0)
    assert all(torch.equal(value, resumed.weights[key]) for key, value in whole.weights.items())


def test_the_command_trains_and_says_where_the_checkpoint_is(tiny_file, home, monkeypatch):
    monkeypatch.setattr("oysterbench_baselines.gtsam_vi_learned.training.MapTrainingSettings", lambda: SMALL)
    words = ["--data", str(tiny_file), "--steps", "1", "--threads", "1"]
    result = CliRunner().invoke(command, words, catch_exceptions=False)
    assert result.exit_code == 0, result.stderr
    path = home / "models" / "gtsam_vi_learned.pt"
    assert result.stdout.strip() == str(path)
    assert read_checkpoint(path).identity["data"] == {"tiny-01": read_footage([tiny_file])[0].digest}
    assert MapModel.read(path).network.settings == NETWORK


# What a user sees


def test_without_a_training_one_line_says_how_to_make_one(home):
    with pytest.raises(
        MethodError,
        match=r"gtsam_vi_learned: no trained weights at .*models/gtsam_vi_learned\.pt: "
        r"`oysterbench train gtsam_vi_learned --data slam-train`",
    ):
        GtsamViLearned().run(None)


def test_a_checkpoint_of_another_method_is_refused(footage, tmp_path):
    checkpoint = train([footage], tmp_path / "one.pt", small(1), 0)
    checkpoint.network["kind"] = "unet"
    with pytest.raises(
        MethodError, match="expected the checkpoint of `oysterbench train gtsam_vi_learned`, got one of"
    ):
        MapModel.of(checkpoint)


def test_the_checkpoint_and_its_use_are_options_of_the_method(footage, tmp_path):
    train([footage], tmp_path / "one.pt", small(1), 0)
    method = find_method(
        "oysterbench_baselines.gtsam_vi_learned:GtsamViLearned"
        f"[checkpoint={tmp_path / 'one.pt'},learned.max_error_px=2]"
    )
    assert method.weights == {"gtsam_vi_learned": tmp_path / "one.pt"}
    described = describe("gtsam_vi_learned", tmp_path / "one.pt")
    assert described.data == {footage.name: footage.digest}
    assert json.loads(card_of(tmp_path / "one.pt", "gtsam_vi_learned", described).data)["training"]["steps"] == 1
    front_end = method.front_end(calibration())
    assert isinstance(front_end, LearnedFrontEnd)
    assert front_end.learned.max_error_px == 2


def calibration() -> CameraCalibration:
    return dive.camera_calibration()
