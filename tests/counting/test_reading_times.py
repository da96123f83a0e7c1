"""Whether a video was read to its end is judged by its duration where its format has no number of frames."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.errors import LabelError
from oysterbench.counting.reading import Sampling, Video
from tests.helpers.people_pictures import SHAPE, write_video

RATE_HZ = 10.0


@pytest.fixture(scope="module")
def matroska(tmp_path_factory):
    """Eight seconds at 10 Hz."""
    frames = [np.full((*SHAPE, 3), 3 * k + 10, np.uint8) for k in range(80)]
    return write_video(tmp_path_factory.mktemp("video") / "dive.mkv", frames, RATE_HZ)


def with_nominal_rate(video, rate_hz, path):
    """A copy that claims another frame rate (DefaultDuration, in ns), as one whose rate varied."""
    data = video.read_bytes()
    at = data.find(b"\x23\xe3\x83")
    size = data[at + 3] & 0x7F
    path.write_bytes(data[: at + 4] + int(1e9 / rate_hz).to_bytes(size, "big") + data[at + 4 + size :])
    return path


def frames_of(path):
    seen = []
    for frame in Video(path).frames(Sampling(every=1), done=lambda index: True):
        seen.append(frame.time_s)
    return seen


def test_a_matroska_file_with_fewer_frames_than_its_nominal_rate_has_is_whole(matroska, tmp_path):
    varied = with_nominal_rate(matroska, 30, tmp_path / "varied.mkv")
    assert Video(varied).claimed == 240
    assert frames_of(varied) == pytest.approx(np.arange(80) / RATE_HZ, abs=2e-3)


class Late:
    """A capture of frames at 30 Hz that begin 5 s after the container."""

    def __init__(self, count):
        self.at, self.count = -1, count

    def grab(self):
        self.at += 1
        return self.at < self.count

    def get(self, key):
        return {0: 1000 * self.at / 30, 71: 150 + self.at}[key]

    def release(self):
        pass


@pytest.mark.parametrize(("count", "whole"), [(150, True), (60, False)])
def test_a_video_that_begins_late_is_whole_if_its_last_frame_is_at_the_end(matroska, count, whole):
    video = Video(matroska)
    video._capture, video.claimed, video.rate_hz = Late(count), 300, 30.0
    frames = video.frames(Sampling(every=1), done=lambda index: True)
    if whole:
        assert len(list(frames)) == count
    else:
        with pytest.raises(LabelError, match=r"cannot be read to its end: 7\.0 of 10\.0 s were; these are counted"):
            list(frames)


@pytest.mark.parametrize("nominal_hz", [RATE_HZ, 30])
def test_a_matroska_file_that_breaks_off_is_named(matroska, nominal_hz, tmp_path):
    cut = with_nominal_rate(matroska, nominal_hz, tmp_path / "cut.mkv")
    data = cut.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    with pytest.raises(LabelError, match=r"cut\.mkv: the video cannot be read to its end: \d\.\d of 8\.0 s were"):
        frames_of(cut)
