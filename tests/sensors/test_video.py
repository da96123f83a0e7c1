"""The video codec: its rate, what it costs, and that it is the same everywhere."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
import pytest

from oysterbench.core.ros import EPOCH_NS
from oysterbench.recipe import CameraRecipe
from oysterbench.sensors.camera import KIND
from oysterbench.sensors.camera_messages import colour_message, read_colour
from oysterbench.sensors.video.codec import ALPHA, BETA, VideoCodec, chroma_qp

CAMERA = CameraRecipe(name="cam", width=192, height=144, hfov_deg=69.0, rate_hz=10.0, video_mbit_s=0.1)
FRAMES = 24


def gliding(n: int = FRAMES) -> np.ndarray:
    """Pictures (n, H, W, 3) of a textured bottom that moves by 5.3 px to the right and 1.5 px down each time."""
    generator = np.random.default_rng(3)
    texture = sum(
        np.kron(generator.normal(0, s, (512 // s, 512 // s)), np.ones((s, s)))[:512, :512] for s in (4, 8, 16)
    )
    spectrum = np.fft.fft2(texture)
    fy, fx = np.fft.fftfreq(512)[:, None], np.fft.fftfreq(512)[None, :]
    smooth = spectrum * np.exp(-((fx**2 + fy**2) * 60))
    pictures = []
    for k in range(n):
        moved = np.fft.ifft2(smooth * np.exp(-2j * np.pi * (fx * 5.3 * k + fy * 1.5 * k))).real[:144, :192]
        grey = np.clip(110 + 6 * moved, 0, 255)
        noisy = grey[..., None] * [0.8, 1.0, 0.9] + generator.normal(0, 1.5, (144, 192, 3))
        pictures.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return np.array(pictures)


@pytest.fixture(scope="module")
def pictures():
    return gliding()


def psnr(a, b):
    return -10 * np.log10(np.mean((a.astype(float) - b) ** 2) / 255**2)


def coded(pictures, mbit_s):
    codec = VideoCodec(144, 192, 10.0, mbit_s)
    found = [(codec.transcode(picture), codec.bits, codec.qp) for picture in pictures]
    return [np.array(column) for column in zip(*found, strict=True)]


@pytest.mark.slow
def test_quality_grows_with_the_rate_and_the_rate_is_kept(pictures):
    quality = []
    for mbit_s in (0.05, 0.1, 0.2, 0.5):
        seen, bits, _ = coded(pictures, mbit_s)
        assert bits[:20].sum() / 2.0 == pytest.approx(mbit_s * 1e6, rel=0.25)
        quality.append(psnr(seen, pictures))
    assert np.all(np.diff(quality) > 1.0)
    assert quality[0] > 25.0
    assert quality[-1] < 48.0


def test_low_rates_cost_texture_first(pictures):
    def fine(seen):
        return np.diff(seen[4:].astype(float), n=2, axis=2).ravel()

    def kept(mbit_s):
        return fine(coded(pictures, mbit_s)[0]) @ fine(pictures) / (fine(pictures) @ fine(pictures))

    shares = [kept(mbit_s) for mbit_s in (0.03, 0.1, 0.5)]
    assert shares[0] < shares[1] < shares[2] < 1.0
    assert shares[0] < 0.8 * shares[2]


def test_motion_is_found_so_that_moving_pictures_cost_little_more_than_a_still_one(pictures):
    _, moving, qp = coded(pictures[:10], 0.2)
    still = np.repeat(pictures[:1], 10, axis=0)
    jumping = pictures[np.random.default_rng(1).permutation(10)]
    codec = VideoCodec(144, 192, 10.0, 0.2)
    for picture in pictures[:2]:
        codec.transcode(picture)
    vectors = codec._vectors.numpy()[2:-2, 2:-2]
    assert np.median(vectors, axis=(0, 1)) == pytest.approx([-3.0, -10.6], abs=1.0)  # half pixels, backwards
    assert coded(still, 0.2)[2][-1] < qp[-1] < coded(jumping, 0.2)[2][-1]
    assert moving[0] > 2 * moving[1:].mean(), "an intra picture takes more than the others"


def test_a_picture_that_does_not_change_is_left_as_it_is_between_intra_pictures(pictures):
    seen, bits, _ = coded(np.repeat(pictures[:1], 8, axis=0), 0.2)
    assert psnr(seen[7], seen[6]) > 45.0
    assert bits[7] < bits[0]


def test_bytes_are_known(pictures):
    """The codec computes in whole numbers: the same on every processor."""
    half = np.rint(np.linspace(0, 255, 192 * 144 * 3)).astype(np.uint8).reshape(144, 192, 3)
    codec = VideoCodec(144, 192, 10.0, 0.05)
    seen = [codec.transcode(np.roll(half, 7 * k, axis=1)) for k in range(3)]
    again = VideoCodec(144, 192, 10.0, 0.05)
    assert all(np.array_equal(a, again.transcode(np.roll(half, 7 * k, axis=1))) for k, a in enumerate(seen))
    assert hashlib.sha256(np.array(seen).tobytes()).hexdigest()[:16] == "794502205d0b76d4"


def test_sizes_that_are_no_multiple_of_macroblocks_come_back_whole():
    picture = gliding(1)[0][:101, :87]
    codec = VideoCodec(101, 87, 10.0, 5.0)
    assert psnr(codec.transcode(picture), picture) > 35.0


def test_frames_are_kept_without_loss_until_they_pass_the_link_and_repeats_stay_repeats(pictures):
    calibration = KIND.read_calibration(KIND.calibrate(CAMERA, None))
    assert KIND._kept_as(CAMERA) == "png"
    assert KIND._kept_as(dataclasses.replace(CAMERA, video_mbit_s=0.0)) == "jpeg"
    assert calibration.width == 192
    shown = [pictures[0], pictures[1], pictures[1], pictures[2]]
    sent = [colour_message(EPOCH_NS + k, "cam", picture, 95, "png") for k, picture in enumerate(shown)]
    camera = dataclasses.replace(CAMERA, image_format="png")
    seen = [read_colour(message.data) for message in KIND.pass_on(camera, "/cam/image", iter(sent))]
    assert [stamp for stamp, _ in seen] == [EPOCH_NS + k for k in range(4)]
    assert np.array_equal(seen[1][1], seen[2][1])
    assert not np.array_equal(seen[1][1], pictures[1])
    other = list(KIND.pass_on(camera, "/cam/depth", iter(sent)))
    assert other == sent


def test_tables_reach_over_all_quantisers():
    assert len(ALPHA) == len(BETA) == 36
    assert [chroma_qp(qp) for qp in (10, 29, 30, 51)] == [10, 29, 29, 39]
