"""Of a video, what a player shows is counted: without the frames that an edit list hides, and with square pixels."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from oysterbench.core.errors import LabelError
from oysterbench.counting.edits import shown_share
from oysterbench.counting.lens import Lens
from oysterbench.counting.per_picture import same_for_all
from oysterbench.counting.reading import Sampling, Video
from oysterbench.counting.run import Counting, Settings
from oysterbench.counting.scale import AltitudeScale
from oysterbench.counting.sources import find_sources
from oysterbench.counting.store import Store
from tests.helpers.people_pictures import SHAPE, Discs, boxed, write_video

RATE_HZ = 10.0


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Six seconds at 10 Hz, as MP4; the left half of each frame is of a grey of its own, the right half black."""
    frames = np.zeros((60, *SHAPE, 3), np.uint8)
    frames[:, :, :80] = (3 * np.arange(60) + 20)[:, None, None, None]
    return write_video(tmp_path_factory.mktemp("phone") / "dive.mp4", frames, RATE_HZ, codec="mp4v")


def ticks(data, header):
    """Ticks per second, by the header of a movie or of its media."""
    return struct.unpack_from(">I", data, data.find(header) + 16)[0]


def trimmed(video, path, begin_s, end_s):
    """A copy that shows the frames between two times, as programs make that do not encode again."""
    data = video.read_bytes()
    edit = (round((end_s - begin_s) * ticks(data, b"mvhd")), round(begin_s * ticks(data, b"mdhd")), 1 << 16)
    edits = struct.pack(">IIIII", 0, 1, *edit)
    path.write_bytes(boxed(data, b"moov", b"trak", b"edts", b"elst", content=edits))
    return path


def of_pixels(video, path, wide, high):
    """A copy whose pixels are as wide as high by a ratio (the box pasp)."""
    data = video.read_bytes()
    at = data.find(b"stsd") + 4
    length = int.from_bytes(data[at + 8 : at + 12], "big")
    entry = data[at + 12 : at + 8 + length].replace(b"pasp", b"free") + struct.pack(">I4sII", 16, b"pasp", wide, high)
    content = data[at : at + 8] + struct.pack(">I", length + 16) + entry
    path.write_bytes(boxed(data, b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", content=content))
    return path


def greys(video):
    return [frame.pixels[60, 40, 0] for frame in Video(video).frames(Sampling(every=1))]


@pytest.mark.parametrize(("begin_s", "end_s"), [(1.7, 6.0), (0.0, 2.5), (2.3, 3.9)])
def test_a_clip_trimmed_without_encoding_it_again_is_whole(whole, tmp_path, begin_s, end_s):
    clip = trimmed(whole, tmp_path / "clip.mp4", begin_s, end_s)
    assert Video(clip).claimed == pytest.approx(RATE_HZ * (end_s - begin_s))
    found = greys(clip)
    assert len(found) == pytest.approx(RATE_HZ * (end_s - begin_s), abs=1)
    assert found[0] == pytest.approx(greys(whole)[round(RATE_HZ * begin_s)], abs=3)


def test_a_trimmed_clip_may_have_most_of_its_frames_in_the_hidden_part(whole, tmp_path):
    data = whole.read_bytes()
    step = struct.unpack_from(">I", data, data.find(b"stts") + 16)[0]
    times = struct.pack(">6I", 0, 2, 30, step // 2, 30, step + step // 2)  # 20 Hz for 1.5 s, then 7 Hz for 4.5 s
    (tmp_path / "varied.mp4").write_bytes(
        boxed(data, b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts", content=times)
    )
    clip = trimmed(tmp_path / "varied.mp4", tmp_path / "clip.mp4", 1.5, 6.0)
    assert Video(clip).claimed == 45
    assert len(greys(clip)) == 30


class Grabs:
    """A capture whose `grab` is replaced."""

    def __init__(self, capture, grab):
        self._capture, self.grab = capture, grab

    def __getattr__(self, name):
        return getattr(self._capture, name)


def test_a_trimmed_clip_that_breaks_off_is_still_named(whole, tmp_path):
    clip = Video(trimmed(whole, tmp_path / "clip.mp4", 1.7, 6.0))
    grab, left = clip._capture.grab, iter(range(30))
    clip._capture = Grabs(clip._capture, lambda: next(left, None) is not None and grab())
    with pytest.raises(LabelError, match=r"cannot be read to its end: 3\.0 of 4\.3 s were"):
        list(clip.frames(Sampling(every=1)))


@pytest.mark.parametrize("short_s", [0.0, 0.001, 0.05])
def test_frames_missing_in_the_middle_are_told_of_although_an_edit_list_is_a_tick_short(whole, tmp_path, short_s):
    clip = Video(trimmed(whole, tmp_path / "clip.mp4", 0.0, 6.0 - short_s))
    grab, taken = clip._capture.grab, iter(range(60))
    clip._capture = Grabs(clip._capture, lambda: all(grab() for _ in range(11 if next(taken) == 20 else 1)))
    with pytest.raises(LabelError, match="cannot be read to its end: 50 of 60 frames were"):
        list(clip.frames(Sampling(every=1)))


@pytest.mark.parametrize("damage", [b"elst", b"mvhd", b"mdhd", b"moov"])
def test_an_index_that_cannot_be_read_hides_nothing(whole, tmp_path, damage):
    data = trimmed(whole, tmp_path / "clip.mp4", 1.7, 6.0).read_bytes()
    at = data.find(damage)
    assert shown_share(tmp_path / "clip.mp4") == pytest.approx(4.3 / 6, abs=0.01)
    (tmp_path / "clip.mp4").write_bytes(data[: at + 4] + bytes(16) + data[at + 20 :])  # ticks per second and all before
    assert shown_share(tmp_path / "clip.mp4") == 1
    (tmp_path / "clip.mp4").write_bytes(data[: at + 6])
    assert shown_share(tmp_path / "clip.mp4") == 1


@pytest.mark.parametrize(("wide", "high", "width"), [(4, 3, 213), (1, 2, 80), (1, 1, 160), (1, 0, 160), (9, 1, 160)])
def test_pixels_that_are_not_square_become_so(whole, tmp_path, wide, high, width):
    first = next(iter(Video(of_pixels(whole, tmp_path / "hdv.mp4", wide, high)).frames(Sampling())))
    assert (first.pixels.shape, first.stored_width) == ((SHAPE[0], width, 3), SHAPE[1])
    lit = (first.pixels[60, :, 0] > 10).sum()
    assert lit == pytest.approx(width / 2, abs=2)


def test_a_video_is_measured_with_a_calibration_of_its_frames_as_they_are_stored(whole, tmp_path):
    clip = of_pixels(whole, tmp_path / "hdv.mp4", 4, 3)
    lens = Lens(SHAPE[1], SHAPE[0], np.array([[150.0, 0, 80], [0, 200, 60], [0, 0, 1]]), np.zeros(4))
    settings = Settings(sampling=Sampling(every=60), scale=same_for_all(AltitudeScale(lens, 2.0)))
    found = Counting(find_sources([clip]).sources, Discs(), {}, Store(tmp_path / "out"), settings).run()
    assert not found.failures
    assert found.pictures[0].area_m2 == pytest.approx(160 / 150 * 2 * 120 / 200 * 2)


def test_pixels_of_a_video_on_its_side_are_those_before_it_was_turned(whole, tmp_path):
    data = of_pixels(whole, tmp_path / "hdv.mp4", 2, 1).read_bytes()
    at = data.find(b"tkhd") + 4 + 40
    quarter = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
    (tmp_path / "hdv.mp4").write_bytes(data[:at] + quarter + data[at + 36 :])
    first = next(iter(Video(tmp_path / "hdv.mp4").frames(Sampling())))
    assert first.pixels.shape[0] / first.pixels.shape[1] == pytest.approx(2 * 160 / 120, rel=0.01)
