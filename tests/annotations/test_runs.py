"""Runs of images: which follow each other, in order of time, and what is held out at their ends."""

from __future__ import annotations

import random

import pytest

from oysterbench.annotations import Entry, ends_of, runs_of


def entries_of(names, clip=""):
    return [Entry(name, clip or name, lambda: pytest.fail("it was read"), ()) for name in names]


def ends(entries, share):
    return [entry.name for run in runs_of(entries) for entry in ends_of(run.entries, share)]


@pytest.mark.parametrize("clip", ["", "reef"])
@pytest.mark.parametrize("form", ["GX{:02}_{:06}", "site{}-{}", "dive{}/f-{:04}"])
def test_of_videos_whose_numbers_restart_the_end_of_each_is_held_out(form, clip):
    """And not, of the longer ones, what has the numbers of the ends of shorter ones."""
    counts = range(100, 420, 40)
    names = [form.format(video, k) for video, count in enumerate(counts) for k in range(count)]
    last = [form.format(video, k) for video, count in enumerate(counts) for k in range(count * 4 // 5, count)]
    assert ends(entries_of(names, clip), 0.2) == last


def test_of_few_videos_of_some_images_the_end_of_each_is_held_out():
    names = [f"site{site}_{k:03}" for site in range(3) for k in range(10 * (site + 1))]
    last = ["site0_009", "site1_018", "site1_019", "site2_027", "site2_028", "site2_029"]
    assert ends(entries_of(names), 0.1) == last


def test_dives_of_two_cameras_each_are_divided_at_the_same_instants_of_both_cameras():
    """Also where a camera lost frames, and dives differ in length."""
    counts = {"dive0": 100, "dive1": 200}
    names = [f"{dive}-left-{k}" for dive, count in counts.items() for k in range(count)]
    names += [f"{dive}-right-{k}" for dive, count in counts.items() for k in range(count - 3)]
    held = ends(entries_of(names), 0.1)
    for dive, count in counts.items():
        left, right = ({int(name.split("-")[2]) for name in held if name.startswith(f"{dive}-{s}")} for s in ("l", "r"))
        assert left == set(range(min(left), count))
        assert right == left - set(range(count - 3, count))
        assert count / 10 <= len(left) <= count / 10 + 3


def test_images_of_cameras_that_took_more_at_the_end_are_not_most_of_those_held_out():
    """Such as a camera of many images at the end that another has at instants of its own."""
    names = [f"a-{k}" for k in range(100)] + [f"b-{k}" for k in (0, 1, *range(92, 100))]
    names += [f"c-{k}" for k in (0, *range(90, 100))] + [f"d-{k}" for k in (0, *range(89, 100))]
    held = ends(entries_of(names), 0.1)
    assert len(held) == len(names) // 10
    assert {int(name.split("-")[1]) for name in held} == {96, 97, 98, 99}


@pytest.mark.parametrize("first", ["dive1-000", "dive1-004"])
def test_a_clip_may_be_named_after_one_of_its_images(first):
    entries = entries_of([f"dive1-{k:03}" for k in range(10)], first)
    (run,) = runs_of([*entries, *entries_of(["other"])])[:1]
    assert run.known
    assert list(run.entries) == entries


@pytest.mark.parametrize("form", ["dive-{:03}", "{}", "reef/cam/{}"])
@pytest.mark.parametrize("clip", ["", "dive"])
def test_images_are_taken_in_order_of_time_in_whichever_order_a_file_lists_them(form, clip):
    names = [form.format(k) for k in range(95, 145)]
    mixed = random.Random(1).sample(names, len(names))
    assert ends(entries_of(mixed, clip), 0.2) == names[-10:]


def test_images_of_a_clip_whose_names_are_no_times_stay_as_they_are_listed():
    names = [f"q{k:02}-{n}" for k in range(12) for n in range(5)]
    for listed in (names[::-1], [f"{name}x" for name in names[::-1]]):
        assert ends(entries_of(listed, "reef"), 0.2) == listed[-12:]


def test_of_names_without_a_mark_before_their_numbers_those_that_are_higher_come_last():
    assert ends(entries_of([f"img{k}" for k in range(1, 61)]), 0.1) == [f"img{k}" for k in range(55, 61)]
