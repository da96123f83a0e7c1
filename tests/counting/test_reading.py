"""Pictures come upright, in 8 bits and RGB, or not at all; of videos just the frames that are asked for."""

from __future__ import annotations

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image

from oysterbench.core.errors import LabelError
from oysterbench.counting.reading import Sampling, Video, decode
from oysterbench.counting.sources import find_sources
from tests.helpers.people_pictures import SHAPE, boxed, discs, turned, write_video


def encoded(suffix, pixels, how=()):
    return cv2.imencode(suffix, pixels, list(how))[1].tobytes()


@pytest.fixture
def colours():
    """(H, W, 3) RGB: red on the left, blue on the right."""
    pixels = np.zeros((*SHAPE, 3), np.uint8)
    pixels[:, :80, 0], pixels[:, 80:, 2] = 250, 250
    return pixels


def test_colours_are_red_green_blue(colours):
    assert np.array_equal(decode(encoded(".png", colours[..., ::-1]), "a"), colours)


def test_a_picture_is_turned_as_its_exif_orientation_says(colours):
    data = encoded(".jpg", colours[..., ::-1])
    upright = decode(turned(data, 6), "a")  # its first row is on the right
    assert upright.shape == (160, 120, 3)
    assert upright[:40, :, 0].min() > 200
    assert upright[120:, :, 2].min() > 200


def test_grey_alpha_and_16_bits_become_three_channels_of_8_bits(colours):
    grey = colours.max(axis=2)
    for made in (grey, grey.astype(np.uint16) * 257, np.dstack([grey, grey, grey, np.zeros_like(grey)])):
        found = decode(encoded(".png", made), "a")
        assert found.dtype == np.uint8
        assert np.array_equal(found, np.dstack([grey] * 3))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_of_more_than_8_bits_the_upper_ones_that_are_used_remain(colours, suffix, bits):
    kept = colours[..., ::-1].astype(np.uint16) << (bits - 8)
    assert np.array_equal(decode(encoded(suffix, kept), "a"), colours)


def test_one_pixel_is_a_picture():
    assert decode(encoded(".png", np.full((1, 1, 3), 7, np.uint8)), "a").shape == (1, 1, 3)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_a_picture_that_is_cut_short_is_refused_and_not_filled_in_with_grey(suffix, share):
    noise = np.random.default_rng(0).integers(0, 255, (*SHAPE, 3), np.uint8)
    data = encoded(suffix, noise)
    with pytest.raises(LabelError, match=r"a: the (JPEG|PNG).* ends before its end marker"):
        decode(data[: int(share * len(data))], "a")


def test_what_a_camera_appends_behind_a_jpeg_does_not_matter():
    data = encoded(".jpg", discs((50, 50)))
    assert decode(data + b"SEFT" * 100, "a").shape == (*SHAPE, 3)


@pytest.mark.parametrize("begin", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("kind", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 4]])
def test_a_jpeg_of_which_a_block_is_lost_is_refused(begin, kind):
    """As a card that fails leaves it: decoders fill in what follows with something else, and say nothing."""
    noise = np.random.default_rng(0).integers(0, 255, (*SHAPE, 3), np.uint8)
    data = bytearray(encoded(".jpg", noise, kind))
    assert decode(bytes(data), "a").shape == (*SHAPE, 3)
    at = int(begin * len(data))
    data[at : at + 512] = bytes(512)
    with pytest.raises(LabelError, match="a: the JPEG is damaged"):
        decode(bytes(data), "a")


@pytest.mark.parametrize("filling", [b"\0" * 64, b"\xff" * 9])
def test_a_jpeg_that_a_camera_filled_up_before_its_end_marker_is_whole(filling):
    data = encoded(".jpg", discs((50, 50)))
    whole = data[:-2] + filling + data[-2:]
    for behind in (b"", b"SEFT" * 100, data):
        assert decode(whole + behind, "a").shape == (*SHAPE, 3)


@pytest.mark.parametrize("mode", ["L", "CMYK"])
def test_a_jpeg_of_other_colours_is_not_taken_for_a_damaged_one(mode):
    file = io.BytesIO()
    Image.fromarray(discs((50, 50))).convert(mode).save(file, "JPEG")
    assert decode(file.getvalue(), "a").shape == (*SHAPE, 3)


def test_a_jpeg_is_not_taken_for_whole_by_the_end_of_its_thumbnail():
    data = encoded(".jpg", discs((50, 50)))
    thumbnail = b"\xff\xe1" + (len(data) + 2).to_bytes(2, "big") + data
    with pytest.raises(LabelError, match="ends before"):
        decode(data[:2] + thumbnail + data[2 : len(data) // 2], "a")


def tiff(*pages, **options):
    tifffile = pytest.importorskip("tifffile", reason="tifffile is not installed: pip install 'oysterbench[maps]'")
    made = io.BytesIO()
    with tifffile.TiffWriter(made, byteorder=options.pop("byteorder", "<"), bigtiff=options.pop("big", False)) as file:
        for page, own in pages:
            file.write(page, **({"photometric": "rgb"} | options | own))
    return made.getvalue()


@pytest.mark.parametrize("options", [{}, {"byteorder": ">"}, {"big": True}])
def test_a_tiff_is_one_picture_and_smaller_copies_of_it(colours, options):
    small = (colours[::4, ::4].copy(), {"subfiletype": 1})
    assert np.array_equal(decode(tiff((colours, {}), small, **options), "a"), colours)
    for pages, said in (
        ([(colours, {})] * 3, "a TIFF of 3 pages"),
        ([small, (colours, {})], "a TIFF that begins with a reduced copy"),
    ):
        with pytest.raises(LabelError, match=f"a: {said}"):
            decode(tiff(*pages, **options), "a")


@pytest.mark.parametrize(
    ("turn", "options", "said"),
    [
        (lambda p: p.astype(np.uint16).transpose(2, 0, 1) * 257, {"planarconfig": "separate"}, "16 bits in separate"),
        (lambda p: p[..., 0].astype(np.uint16) * 257, {"photometric": "miniswhite"}, "with white as 0"),
        (lambda p: p.astype(np.float32), {}, "expected an image of 8 or 16 bits, got float32"),
    ],
)
def test_a_tiff_that_is_decoded_wrongly_is_refused(colours, turn, options, said, capfd):
    with pytest.raises(LabelError, match=said):
        decode(tiff((turn(colours).copy(), options)), "a")
    assert capfd.readouterr().err == ""


def test_an_animation_is_not_taken_for_its_first_picture(colours):
    pillow = pytest.importorskip("PIL.Image")
    first, second = (pillow.fromarray(one) for one in (colours, colours[:, ::-1].copy()))
    for kind in ("webp", "png"):
        for others, refused in (([second], True), ([], False)):
            made = io.BytesIO()
            first.save(made, format=kind, save_all=True, append_images=others, lossless=True)
            if refused:
                with pytest.raises(LabelError, match="a: an animation"):
                    decode(made.getvalue(), "a")
            else:
                assert np.array_equal(decode(made.getvalue(), "a"), colours)


@pytest.mark.parametrize("length", range(8, 31))
def test_bytes_that_only_begin_like_an_image_are_one_line(length):
    for head in (b"RIFF\0\0\0\0WEBPVP8X", b"II*\0\x08\0\0\0\xff\xff", b"MM\0+\0\x08\0\0", b"\0\0\0\x18ftyp"):
        with pytest.raises(LabelError, match="a: cannot be decoded as an image"):
            decode((head + bytes(30))[:length], "a")


def test_a_format_that_cannot_be_read_is_named_whatever_its_file_is_called():
    with pytest.raises(LabelError, match=r"IMG\.jpg: HEIC, whatever its name says"):
        decode(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(300), "IMG.jpg")


@pytest.mark.parametrize(("data", "said"), [(b"", "empty file"), (b"GIF, or so", "cannot be decoded")])
def test_what_is_no_picture_is_one_line(data, said):
    with pytest.raises(LabelError, match=f"a: {said}"):
        decode(data, "a")


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_a_picture_that_is_too_large_is_told_its_size(suffix):
    data = encoded(suffix, np.zeros((1 << 6, 1 << 5), np.uint8))
    if suffix == ".jpg":
        at = data.find(b"\xff\xc0") + 5
        data = data[:at] + struct.pack(">HH", 8000, 12000) + data[at + 4 :]
    elif suffix == ".png":
        header = b"IHDR" + struct.pack(">II", 12000, 8000) + data[24:29]
        data = data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]
    else:
        data = data.replace(struct.pack("<HHII", 256, 3, 1, 1 << 5), struct.pack("<HHII", 256, 4, 1, 12000))
        data = data.replace(struct.pack("<HHII", 257, 3, 1, 1 << 6), struct.pack("<HHII", 257, 4, 1, 8000))
    with pytest.raises(LabelError, match=r"a: expected at most 67 megapixels, got 12000 x 8000 px: cut it into tiles"):
        decode(data, "a")


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Ten seconds at 10 Hz, each frame of a grey of its own."""
    frames = [np.full((*SHAPE, 3), 2 * k + 20, np.uint8) for k in range(100)]
    return write_video(tmp_path_factory.mktemp("video") / "dive ü.avi", frames)


def test_a_frame_a_second_is_looked_at(video):
    found = list(Video(video).frames(Sampling(1.0)))
    assert [frame.index for frame in found] == list(range(0, 100, 10))
    assert [frame.time_s for frame in found] == pytest.approx(range(10), abs=1e-3)
    assert [int(frame.pixels.mean()) for frame in found] == pytest.approx(
        [2 * k + 20 for k in range(0, 100, 10)], abs=2
    )


def test_every_nth_frame_or_more_than_there_are_a_second(video):
    assert [f.index for f in Video(video).frames(Sampling(every=33))] == [0, 33, 66, 99]
    assert [f.index for f in Video(video).frames(Sampling(50.0))] == list(range(100))
    assert Video(video).estimate(Sampling(2.0)) == 20


def test_frames_that_are_done_are_not_decoded(video):
    found = list(Video(video).frames(Sampling(every=25), done=lambda index: index > 25))
    assert [frame.pixels is None for frame in found] == [False, False, True, True]


def test_a_video_that_is_none_or_empty_is_refused(tmp_path, capfd):
    (tmp_path / "bad.mp4").write_bytes(bytes(3000))
    with pytest.raises(
        LabelError, match=r"bad\.mp4: the video cannot be read, none of its frames were: 3000 bytes of no known"
    ):
        Video(tmp_path / "bad.mp4")
    empty = write_video(tmp_path / "empty.avi", [])
    with pytest.raises(LabelError, match=r"empty\.avi: the video cannot be read, none of its frames were"):
        list(Video(empty).frames(Sampling()))
    assert capfd.readouterr().err == ""


def test_a_video_that_breaks_off_gives_what_it_has_and_then_says_so(video, tmp_path):
    cut = tmp_path / "cut.avi"
    data = video.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    seen = []
    frames = (seen.append(frame.index) for frame in Video(cut).frames(Sampling(every=1)))
    with pytest.raises(LabelError, match=r"cannot be read to its end: \d+ of 100 frames were"):
        list(frames)
    assert 20 < len(seen) < 80


@pytest.fixture(scope="module")
def phone_video(tmp_path_factory):
    """Six seconds at 10 Hz, as MP4."""
    frames = [np.full((*SHAPE, 3), 3 * k + 20, np.uint8) for k in range(60)]
    return write_video(tmp_path_factory.mktemp("phone") / "dive.mp4", frames, codec="mp4v")


def test_a_video_without_its_index_is_said_to_be_cut_short_with_no_frame_read(phone_video, tmp_path):
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(phone_video.read_bytes()[:-1000])
    with pytest.raises(LabelError, match=r"cut\.mp4: .*none of its frames were: it ends before its index \(moov\)"):
        Video(cut)


def retimed(video, folder, *runs):
    """A copy of an MP4 whose frames last a multiple of what they did: (number of frames, factor) by runs."""
    data = video.read_bytes().replace(b"edts", b"free")  # an edit list would cut what is longer
    step = struct.unpack(">I", data[data.find(b"stts") + 16 :][:4])[0]
    times = struct.pack(f">{2 + 2 * len(runs)}I", 0, len(runs), *(n for many, k in runs for n in (many, k * step)))
    (folder / "retimed.mp4").write_bytes(
        boxed(data, b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts", content=times)
    )
    return folder / "retimed.mp4"


def test_frames_of_a_variable_rate_are_taken_by_their_own_times(phone_video, tmp_path):
    varied = retimed(phone_video, tmp_path, (20, 1), (20, 5), (20, 1))
    found = list(Video(varied).frames(Sampling(1.0)))
    assert [frame.time_s for frame in found] == pytest.approx(range(14), abs=1e-3)
    assert [frame.index for frame in found] == [0, 10, 20, 22, 24, 26, 28, 30, 32, 34, 36, 38, 40, 50]


def test_behind_a_gap_frames_are_as_far_apart_as_before(phone_video, tmp_path):
    found = list(Video(retimed(phone_video, tmp_path, (19, 1), (1, 81), (40, 1))).frames(Sampling(1.0)))
    assert [frame.index for frame in found] == [0, 10, 20, 30, 40, 50]
    assert [frame.time_s for frame in found] == pytest.approx([0, 1, 10, 11, 12, 13], abs=1e-3)


def test_time_goes_on_where_the_timestamps_of_joined_recordings_begin_again(tmp_path):
    frames = [np.full((*SHAPE, 3), 3 * k + 20, np.uint8) for k in range(40)]
    one = write_video(tmp_path / "one.ts", frames, codec="mp4v").read_bytes()
    (tmp_path / "both.ts").write_bytes(one + one)
    found = list(Video(tmp_path / "both.ts").frames(Sampling(1.0)))
    assert [frame.index for frame in found] == list(range(0, 80, 10))
    assert [frame.time_s for frame in found] == pytest.approx(range(8), abs=1e-3)


@pytest.mark.parametrize("rate_hz", [30.0, 30000 / 1001, 15.0])
def test_stamps_in_whole_milliseconds_lose_no_frame_at_the_videos_own_rate(phone_video, monkeypatch, rate_hz):
    """As in Matroska files: 0, 33, 67, 100 ms, some of them before they are due."""
    video = Video(phone_video)
    monkeypatch.setattr(video, "_times_s", lambda: iter([round(k / rate_hz, 3) for k in range(150)]))
    monkeypatch.setattr(video, "claimed", 150)
    assert len(list(video.frames(Sampling(round(rate_hz)), lambda index: True))) >= 149


def test_a_moving_gif_is_a_video(tmp_path):
    path = tmp_path / "ten.gif"
    pillow = pytest.importorskip("PIL.Image")
    first, *others = [pillow.fromarray(np.full((*SHAPE, 3), 20 + 20 * k, np.uint8)) for k in range(10)]
    first.save(path, save_all=True, append_images=others, duration=200)
    assert [source.video for source in find_sources([path]).sources] == [True]
    found = list(Video(path).frames(Sampling(1.0)))
    assert [(frame.index, round(frame.pixels.mean())) for frame in found] == [(0, 20), (5, 120)]
