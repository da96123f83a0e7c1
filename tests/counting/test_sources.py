"""What is found at paths: pictures and videos, each under a name of its own, and what is neither."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from oysterbench.core.errors import LabelError
from oysterbench.core.pictures import decode_picture
from oysterbench.counting.labels import seeming_labels
from oysterbench.counting.sources import find_sources
from tests.helpers.labelled_folders import oysters, picture, write_png


def touch(folder: Path, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")
    return folder


def names_of(*paths, **options):
    return [source.name for source in find_sources(paths, **options).sources]


def test_a_folder_is_looked_through_to_its_end_and_names_are_below_it(tmp_path):
    touch(tmp_path, "b.JPG", "deep/er/a.png", "dive.MP4", "ü b/c d.tif")
    assert names_of(tmp_path) == ["b", "deep/er/a", "dive.MP4", "ü b/c d"]


def test_neighbours_are_in_the_order_of_their_numbers(tmp_path):
    touch(tmp_path, *(f"photo-{k}.jpg" for k in (10, 2, 1, 11)), "photo-02.jpg")
    assert names_of(tmp_path) == ["photo-1", "photo-02", "photo-2", "photo-10", "photo-11"]


def test_pictures_of_one_name_in_two_folders_stay_apart(tmp_path):
    touch(tmp_path, "one/1.jpg", "two/1.jpg")
    assert names_of(tmp_path) == ["one/1", "two/1"]
    assert names_of(tmp_path / "one", tmp_path / "two") == ["one/1", "two/1"]


def test_pictures_that_differ_by_suffix_alone_keep_it(tmp_path):
    touch(tmp_path, "a.jpg", "a.png", "b.png")
    assert names_of(tmp_path) == ["a.jpg", "a.png", "b"]
    touch(tmp_path, "a.jpg.tif", "c.jpg.tif")
    assert names_of(tmp_path) == ["a.jpg", "a.jpg.tif", "a.png", "b", "c.jpg"]


def test_a_file_that_is_given_twice_counts_once(tmp_path):
    touch(tmp_path, "a.jpg")
    assert names_of(tmp_path, tmp_path / "a.jpg", tmp_path / "a.jpg") == ["a"]


def test_the_folder_of_results_is_not_looked_into(tmp_path):
    touch(tmp_path, "a.jpg", "out/overlays/a.jpg")
    assert names_of(tmp_path, leave_out=tmp_path / "out") == ["a"]


def test_raw_copies_of_pictures_are_told_apart_from_what_is_there_in_no_other_format(tmp_path):
    found = find_sources([touch(tmp_path, "a.JPG", "a.DNG", "b.HEIC", "deep/a.heic")])
    assert [path.name for path in found.copies] == ["a.DNG"]
    assert [path.name for path in found.to_convert] == ["b.HEIC", "a.heic"]
    assert set(found.unreadable()) == {"b.HEIC", "deep/a.heic"}


def test_files_whose_names_results_cannot_have_are_told_of_by_themselves(tmp_path):
    touch(tmp_path, "a.jpg", "x" * 221 + ".jpg")
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/M\xfcll.png")).write_bytes(b"x")
    found = find_sources([tmp_path])
    assert [source.name for source in found.sources] == ["a"]
    assert set(found.unreadable()) == {"M\N{REPLACEMENT CHARACTER}ll.png", "x" * 221 + ".jpg"}
    assert all("expected a name in UTF-8 of at most 220 bytes: rename it" in why for why in found.unreadable().values())
    with pytest.raises(LabelError, match="got only M\N{REPLACEMENT CHARACTER}ll"):
        find_sources([next(path for path in tmp_path.iterdir() if "ll" in path.name)])


def test_what_is_no_file_is_not_waited_for(tmp_path):
    os.mkfifo(touch(tmp_path, "a.jpg") / "pipe.jpg")
    found = find_sources([tmp_path])
    assert [source.name for source in found.sources] == ["a"]
    assert [path.name for path in found.others] == ["pipe.jpg"]


def test_labels_beside_images_and_results_of_other_counts_are_told_and_not_counted_as_images(tmp_path):
    touch(tmp_path, "images/a.jpg", "masks/a.png", "instances/a.png", "deep/masks/b.jpg")
    touch(tmp_path, "old/overlays/a.jpg", "old/masks/a.png", "old/finished/a.json")
    found = find_sources([tmp_path])
    assert [source.name for source in found.sources] == ["deep/masks/b", "images/a"]
    assert [path.name for path in found.skipped] == ["instances", "masks", "old"]
    with pytest.raises(LabelError, match="old: expected images, got the results of a count"):
        find_sources([tmp_path / "old"])


@pytest.mark.parametrize(
    ("images", "labels"),
    [
        ("img", ["masks_human", "masks_machine"]),
        ("JPEGImages", ["SegmentationClass", "SegmentationClassPNG", "SegmentationObject"]),
        ("Images", ["Masks", "labels"]),
    ],
)
def test_labels_of_other_programs_beside_images_are_not_counted_as_images(images, labels, tmp_path):
    touch(tmp_path, f"set/{images}/a.jpg", *(f"set/{name}/a.png" for name in labels))
    found = find_sources([tmp_path])
    assert [source.name for source in found.sources] == [f"set/{images}/a"]
    assert [path.name for path in found.skipped] == labels


def test_masks_in_the_folder_of_their_images_are_not_counted(tmp_path):
    """As Roboflow writes them."""
    found = find_sources([touch(tmp_path, "a.jpg", "a_mask.png", "b_mask.png", "deep/a_mask.png")])
    assert [source.name for source in found.sources] == ["a", "b_mask", "deep/a_mask"]
    assert [path.name for path in found.skipped] == ["a_mask.png"]


def test_folders_of_other_names_that_seem_to_hold_labels_are_told_by_their_names_and_few_colours(tmp_path):
    for folder in ("photos", "right"):
        write_png(tmp_path / folder / "a.png", picture(0))
        write_png(tmp_path / folder / "b.png", picture(1))
    for folder in ("gt", "right/truth", "more"):
        write_png(tmp_path / folder / "b.png", oysters(0))
    write_png(tmp_path / "more" / "c.png", oysters(0))
    touch(tmp_path, "odd/a.png")
    found = seeming_labels(source.path for source in find_sources([tmp_path]).sources)
    assert found == {tmp_path / "gt": tmp_path / "photos", tmp_path / "right/truth": tmp_path / "right"}


def test_the_first_images_of_many_folders_are_decoded_once_each_to_tell_labels(tmp_path, monkeypatch):
    """All may have few colours, such as the black first frames of videos."""
    pictures = [tmp_path / f"dive{k}" / "0.png" for k in range(5)]
    for path in pictures:
        write_png(path, np.zeros((4, 4, 3), np.uint8))
    decoded = []
    monkeypatch.setattr(
        "oysterbench.counting.labels.decode_picture", lambda *args: decoded.append(args) or decode_picture(*args)
    )
    assert seeming_labels(pictures) == {}
    assert len(decoded) == 5


def test_hidden_folders_are_told_and_not_looked_into(tmp_path):
    """Such as those of notebooks, with a copy of each image that was opened."""
    folder = touch(tmp_path / ".set", "a.jpg", ".ipynb_checkpoints/a-checkpoint.jpg", "deep/.trash/b.jpg")
    found = find_sources([folder])
    assert [source.name for source in found.sources] == ["a"]
    assert [path.name for path in found.skipped] == [".ipynb_checkpoints", ".trash"]


def test_results_do_not_go_into_the_folder_of_the_images_itself(tmp_path):
    touch(tmp_path, "a.jpg")
    with pytest.raises(LabelError, match="expected another folder for the results than that of the images"):
        find_sources([tmp_path], leave_out=tmp_path)


def test_what_is_neither_picture_nor_video_is_told_apart_from_formats_that_cannot_be_read(tmp_path):
    found = find_sources([touch(tmp_path, "a.jpg", "notes.txt", "._a.jpg", "IMG.HEIC")])
    assert sorted(path.name for path in found.others) == ["._a.jpg", "notes.txt"]
    assert [path.name for path in found.to_convert] == ["IMG.HEIC"]


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ((), "got an empty folder"),
        (("notes.txt",), "got only notes.txt"),
        (("a.heic",), "a.heic, of a format that cannot"),
        ((".trash/a.jpg",), "got only .trash, left out as labels, as results of another count, or as hidden"),
        ((".trash/a.jpg", "notes.txt"), "got only notes.txt, and .trash, left out as labels, as results"),
    ],
)
def test_nothing_to_count_is_an_error_that_says_what_is_there(tmp_path, files, said):
    with pytest.raises(LabelError, match=re.escape(said)):
        find_sources([touch(tmp_path, *files)])


def test_a_path_that_is_not_there_is_named(tmp_path):
    with pytest.raises(LabelError, match="gone: no such file or folder"):
        find_sources([tmp_path / "gone"])


def test_a_folder_that_may_not_be_looked_into_is_told_of_and_the_rest_is_counted(tmp_path, monkeypatch):
    touch(tmp_path, "a.jpg", "locked/b.jpg")
    whole = os.scandir

    def scandir(path):
        if Path(path).name == "locked":
            raise PermissionError(13, "Permission denied", str(path))
        return whole(path)

    monkeypatch.setattr(os, "scandir", scandir)
    found = find_sources([tmp_path])
    assert [source.name for source in found.sources] == ["a"]
    (why,) = found.unreadable().values()
    assert why == f"{tmp_path / 'locked'}: a folder that you may not look into: change its permissions"


def test_an_image_of_the_name_of_a_video_keeps_its_suffix(tmp_path):
    touch(tmp_path, "GX01.MP4", "GX01.MP4.jpg", "GX02.jpg")
    found = find_sources([tmp_path]).sources
    assert [(one.name, one.video) for one in found] == [("GX01.MP4", True), ("GX01.MP4.jpg", False), ("GX02", False)]


@pytest.mark.parametrize("name", ["clip.TS", "clip.m2ts", "clip.3gp"])
def test_transport_streams_and_films_of_phones_are_videos(tmp_path, name):
    touch(tmp_path, name)
    assert [source.video for source in find_sources([tmp_path]).sources] == [True]
