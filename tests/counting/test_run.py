"""Counting goes on where it was interrupted, past what is broken, and is made anew where anything has changed."""

from __future__ import annotations

import itertools
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest

from oysterbench.annotations.image import read_plane
from oysterbench.core.errors import MethodError
from oysterbench.counting.film import film_rate
from oysterbench.counting.identity import method_identity
from oysterbench.counting.overlay import COLOURS, overlay, overlay_factor
from oysterbench.counting.per_picture import plain
from oysterbench.counting.reading import Sampling, decode
from oysterbench.counting.run import Counting, Settings
from oysterbench.counting.sources import find_sources
from oysterbench.counting.store import Store
from tests.helpers.image_methods import Another, Lazy, Raises, Small
from tests.helpers.people_pictures import Discs, FailsOnDark, discs, write, write_video


@pytest.fixture
def folder(tmp_path):
    """Three pictures: two discs, one, none."""
    write(tmp_path / "in" / "a b.png", discs((40, 40), (100, 60)))
    write(tmp_path / "in" / "b.png", discs((40, 40)))
    write(tmp_path / "in" / "c.png", discs())
    return tmp_path / "in"


def count(folder, out, method=None, again=False, identity=None, **settings):
    """What comes of it, and how many pictures the method was asked."""
    Discs.asked = 0
    sources = find_sources([folder]).sources
    store = Store(out)
    if again:
        store.start_over(*([one.name for one in sources if one.video is video] for video in (False, True)))
    made = Counting(sources, method or Discs(), identity or {"method": "m"}, store, Settings(**settings))
    return made.run(), Discs.asked


def test_each_picture_gets_mask_overlay_and_counts(folder, tmp_path):
    found, asked = count(folder, tmp_path / "out")
    assert asked == 3
    assert [(one.name, one.oysters, one.live) for one in found.pictures] == [("a b", 2, 1), ("b", 1, 0), ("c", 0, 0)]
    assert np.unique(read_plane(tmp_path / "out" / "masks" / "a b.png")).tolist() == [0, 1, 2]
    assert read_plane(tmp_path / "out" / "masks" / "a b.png").dtype == np.uint16
    assert (tmp_path / "out" / "overlays" / "c.jpg").is_file()
    rows = Store(tmp_path / "out").oysters("a b")
    assert [row.box for row in rows] == [(30, 30, 21, 21), (90, 50, 21, 21)]


class Interrupted(Discs):
    """Ctrl-C at the second image or frame."""

    def run(self, images):
        yield from itertools.islice(super().run(images), 1)
        raise KeyboardInterrupt


@pytest.mark.parametrize("taken", ["folder", "video"])
def test_after_an_interrupted_recount_nothing_is_of_the_count_before(request, tmp_path, taken):
    """Though the key of an image is the same, as where weights that no method declares have changed."""
    place, out = request.getfixturevalue(taken), tmp_path / "out"
    asked = count(place, out)[1]
    with pytest.raises(KeyboardInterrupt):
        count(place, out, Interrupted(), again=True)
    assert count(place, out)[1] == asked - 1
    assert count(place, out)[1] == 0


def test_what_is_finished_is_not_done_again_unless_something_has_changed(folder, tmp_path):
    out = tmp_path / "out"
    first, _ = count(folder, out)
    second, asked = count(folder, out)
    assert (asked, second.made, second.pictures) == (0, 0, first.pictures)
    assert count(folder, out, again=True)[1] == 3
    assert count(folder, out)[1] == 0
    assert count(folder, out, identity={"method": "another"})[1] == 3
    assert count(folder, out, threshold=0.6)[1] == 3
    assert count(folder, out, threshold=0.6, scale=plain(1.0))[1] == 3
    write(folder / "b.png", discs((20, 20), (60, 60), (120, 90)))
    found, asked = count(folder, out, threshold=0.6, scale=plain(1.0))
    assert (asked, [one.oysters for one in found.pictures]) == (1, [2, 3, 0])


def test_a_method_is_not_even_begun_where_all_is_finished(folder, tmp_path):
    count(folder, tmp_path / "out")
    assert len(count(folder, tmp_path / "out", method=Raises())[0].pictures) == 3


def test_an_interrupted_run_keeps_what_was_finished_and_goes_on_from_there(folder, tmp_path):
    class Interrupted(Discs):
        def predict(self, image):
            if image.name == "c":
                raise KeyboardInterrupt
            return super().predict(image)

    with pytest.raises(KeyboardInterrupt):
        count(folder, tmp_path / "out", method=Interrupted())
    assert not list((tmp_path / "out").rglob(".*.png*")), "nothing half-written"
    found, asked = count(folder, tmp_path / "out")
    assert (asked, len(found.pictures)) == (1, 3)


def test_a_record_without_its_overlay_or_mask_or_of_another_version_does_not_count_as_finished(folder, tmp_path):
    count(folder, tmp_path / "out")
    (tmp_path / "out" / "overlays" / "b.jpg").unlink()
    (tmp_path / "out" / "finished" / "c.json").write_text('{"key": 1}')
    assert count(folder, tmp_path / "out")[1] == 2
    (tmp_path / "out" / "masks" / "b.png").unlink()
    assert count(folder, tmp_path / "out")[1] == 1


def test_pictures_that_were_moved_are_finished_still_and_known_by_their_new_place(folder, tmp_path):
    count(folder, tmp_path / "out")
    folder.rename(tmp_path / "elsewhere")
    found, asked = count(tmp_path / "elsewhere", tmp_path / "out")
    assert asked == 0
    assert found.pictures[0].file == str(tmp_path / "elsewhere" / "a b.png")


def test_broken_pictures_are_told_of_and_the_rest_goes_on(folder, tmp_path):
    (folder / "b.png").write_bytes(b"\x89PNG no more")
    (folder / "d.mp4").write_bytes(bytes(100))
    found, _ = count(folder, tmp_path / "out")
    assert [one.name for one in found.pictures] == ["a b", "c"]
    assert set(found.failures) == {"b", "d.mp4"}


def test_a_picture_that_a_method_fails_on_is_told_of_and_the_rest_goes_on(folder, tmp_path):
    found, _ = count(folder, tmp_path / "out", method=FailsOnDark())
    assert [one.name for one in found.pictures] == ["a b", "b"]
    assert found.failures == {"c": "the method failed on it: ZeroDivisionError: no contrast"}


def test_a_method_that_fails_on_three_pictures_one_after_the_other_is_not_tried_on_more(folder, tmp_path):
    with pytest.raises(MethodError, match="method 'raises' failed on c: ValueError: no idea"):
        count(folder, tmp_path / "out", method=Raises())


@pytest.mark.parametrize(
    ("method", "said"),
    [
        (Small(), "on a b: expected a prediction of the image's size, 160 x 120, got 2 x 2"),
        (Another(), "expected a prediction for a b, got one for 'x'"),
        (Lazy(), "ended without a result for b|for the pictures"),
    ],
)
def test_a_method_that_does_not_answer_as_agreed_is_refused(folder, tmp_path, method, said):
    class Eager(type(method)):
        def run(self, images):
            return super().run(list(images))

    with pytest.raises(MethodError, match=said):
        count(folder, tmp_path / "out", method=Eager())


def test_a_method_that_does_not_ask_for_all_pictures_is_refused(folder, tmp_path):
    with pytest.raises(MethodError, match="method 'lazy' ended without a result for b"):
        count(folder, tmp_path / "out", method=Lazy())


def test_whatever_a_decoder_raises_is_a_failure_of_its_file_alone(folder, tmp_path, monkeypatch):
    def picky(data, where):
        if where.endswith("a b.png"):
            raise cv2.error("assertion in some codec")
        return decode(data, where)

    monkeypatch.setattr("oysterbench.counting.run.decode", picky)
    found, _ = count(folder, tmp_path / "out")
    assert [one.name for one in found.pictures] == ["b", "c"]
    assert "error: assertion in some codec" in found.failures["a b"]


@pytest.fixture
def video(tmp_path):
    """Four seconds at 10 Hz, one disc more in each."""
    places = [(20, 30), (60, 30), (100, 30), (140, 30)]
    shown = [discs(*places[: k // 10 + 1]) for k in range(40)]
    (tmp_path / "in").mkdir()
    return write_video(tmp_path / "in" / "dive ü.avi", shown)


def test_a_video_is_counted_frame_by_frame_and_has_a_film(video, tmp_path):
    found, asked = count(video, tmp_path / "out")
    assert asked == 4
    assert [(one.name, one.time_s, one.oysters) for one in found.pictures] == [
        (f"dive ü.avi/{10 * k:06d}", pytest.approx(k, abs=1e-3), k + 1) for k in range(4)
    ]
    film = found.films["dive ü.avi"]
    assert film == tmp_path / "out" / "videos" / "dive ü.avi.mp4"
    capture = cv2.VideoCapture(str(film))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 4
    assert [path.name for path in film.parent.iterdir()] == [film.name], "nothing half-written"


def test_a_finished_video_is_not_decoded_and_other_sampling_takes_what_it_can(video, tmp_path, monkeypatch):
    out = tmp_path / "out"
    first, _ = count(video, out)
    found, asked = count(video, out, sampling=Sampling(2.0))
    assert (asked, len(found.pictures)) == (4, 8), "every second frame was there"
    monkeypatch.setattr("oysterbench.counting.run.Video", None)
    again, asked = count(video, out, sampling=Sampling(2.0))
    assert (asked, len(again.pictures)) == (0, 8)
    assert [one.name for one in first.pictures] == [one.name for one in again.pictures][::2]


def test_a_film_is_always_of_the_frames_that_are_counted(video, tmp_path):
    for sampling, frames in ((Sampling(2.0), 8), (Sampling(1.0), 4)):
        (film,) = count(video, tmp_path / "out", sampling=sampling)[0].films.values()
        assert cv2.VideoCapture(str(film)).get(cv2.CAP_PROP_FRAME_COUNT) == frames
    before = film.stat().st_mtime_ns
    count(video, tmp_path / "out", sampling=Sampling(1.0))
    assert film.stat().st_mtime_ns == before


def test_a_video_that_was_interrupted_goes_on_from_its_last_frame(video, tmp_path):
    class Interrupted(Discs):
        def predict(self, image):
            if image.name.endswith("20"):
                raise KeyboardInterrupt
            return super().predict(image)

    with pytest.raises(KeyboardInterrupt):
        count(video, tmp_path / "out", method=Interrupted())
    found, asked = count(video, tmp_path / "out")
    assert (asked, len(found.pictures)) == (2, 4)


def test_each_video_has_a_film_of_its_own():
    store = Store(Path("out"))
    videos = ["dive.avi", "dive.avi.mp4", "dive.MP4", "dive.avi.mp4.mp4", "dive.mp4"]
    assert len({store.film(video) for video in videos}) == len(videos)
    assert store.film("dive.mp4").name == "dive.mp4"


def test_films_are_no_slower_than_four_frames_a_second():
    assert film_rate([0.0, 1.0, 2.0]) == 4.0
    assert film_rate([0.0, 0.1, 0.2]) == pytest.approx(10.0)
    assert film_rate([3.0]) == 4.0


def test_changed_weights_options_and_code_change_a_methods_identity(tmp_path, monkeypatch):
    method = Discs()
    monkeypatch.setattr(method, "weights", {"my_net": tmp_path / "my.pt"}, raising=False)
    none = method_identity("my_net", method, {})
    (tmp_path / "my.pt").write_bytes(b"1")
    first = method_identity("my_net", method, {})
    (tmp_path / "other.pt").write_bytes(b"2")
    assert method_identity("my_net", method, {}) == first != none
    (tmp_path / "my.pt").write_bytes(b"3")
    assert method_identity("my_net", method, {}) != first
    named = method_identity("my_net", Discs(), {"checkpoint": str(tmp_path / "other.pt"), "size": 3})
    assert "file of checkpoint" in named["files"]
    alike = {"coarse": tmp_path / "a" / "net.pt", "fine": tmp_path / "b" / "net.pt"}
    for path in alike.values():
        path.parent.mkdir()
        path.write_bytes(b"1")
    options = {key: str(path) for key, path in alike.items()}
    both = method_identity("my_net", Discs(), options)
    alike["coarse"].write_bytes(b"2")
    assert method_identity("my_net", Discs(), options) != both, "files of one name are told apart"


def test_changed_code_of_a_method_changes_its_identity(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_own_net.py").write_text("class Net: ...\n")
    net = import_module("my_own_net").Net()
    first = method_identity("my_own_net:Net", net, {})
    (tmp_path / "unrelated.py").write_text("")
    assert method_identity("my_own_net:Net", net, {}) == first
    (tmp_path / "my_own_net.py").write_text("class Net:\n    size = 3\n")
    assert method_identity("my_own_net:Net", net, {}) != first


@pytest.mark.parametrize(
    ("shape", "factor"), [((1, 1), 8), ((120, 160), 4), ((640, 480), 1), ((3000, 4000), 2048 / 4000)]
)
def test_overlays_are_neither_too_small_to_read_nor_too_large_to_send(shape, factor):
    assert overlay_factor(shape) == pytest.approx(factor)


def test_an_overlay_shows_states_and_quadrat_in_colours_of_their_own_and_what_is_left_out_in_none(folder, tmp_path):
    found, _ = count(folder, tmp_path / "out")
    picture, rows = found.pictures[0], Store(tmp_path / "out").oysters("a b")
    numbers = read_plane(tmp_path / "out" / "masks" / "a b.png")
    square = np.array([[70, 10], [150, 10], [150, 110], [70, 110.0]])
    pixels = np.zeros((120, 160, 3), np.uint8)

    def has(drawn, colour):
        return (np.abs(drawn[40:].astype(int) - colour).sum(axis=2) < 30).any()

    drawn = overlay(pixels, numbers, rows, picture, None)
    assert has(drawn, COLOURS["live"])
    assert has(drawn, COLOURS["dead"])
    assert not has(drawn, (255, 255, 255))
    outside = [replace(row, counted=row.state == "live") for row in rows]
    drawn = overlay(pixels, numbers, outside, picture, square)
    assert has(drawn, COLOURS["live"])
    assert not has(drawn, COLOURS["dead"])
    assert has(drawn, COLOURS["left out"])
    assert has(drawn, (255, 255, 255))


def test_an_overlay_has_no_strip_where_nothing_can_be_written(folder, tmp_path):
    found, _ = count(folder, tmp_path / "out")
    one = replace(found.pictures[2], width=1, height=1)
    assert overlay(np.zeros((1, 1, 3), np.uint8), None, [], one, None).shape == (8, 8, 3)
    assert overlay(discs(), None, [], found.pictures[2], None).shape[0] > 4 * 120


def test_an_overlay_of_an_unlike_picture_has_an_orange_frame(folder, tmp_path):
    found, _ = count(folder, tmp_path / "out")
    strange = replace(found.pictures[2], novelty=1.5)
    plain_one, warned = (overlay(discs(), None, [], one, None) for one in (found.pictures[2], strange))
    assert tuple(warned[-1, -1]) == (213, 94, 0)
    assert tuple(plain_one[-1, -1]) == (0, 0, 0)
