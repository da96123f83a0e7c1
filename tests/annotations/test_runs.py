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
@pytest.mark.parametrize("form", ["GX{:02}_{:06}", "site{}-{}", "dive{}/f-{:04}", "20260501_1{}3002_{:06}"])
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


STEREO = ["dive{d}_{side}_{k:04}", "dive{d}/{side}/{k}", "{side}/dive{d}-{k:03}", "dive{d}_{k:03}_{side}"]


@pytest.mark.parametrize("form", ["2026-05-01 {h:02}-{m:02}-{s:02}", "reef 2026-05-01 {h:02}_{m:02}_{s:02}"])
def test_a_space_is_a_mark_between_date_and_time(form):
    """Else the end of each hour would be held out."""
    names = [form.format(h=12 + k // 180, m=k // 3 % 60, s=k % 3 * 20) for k in range(120, 240)]
    assert ends(entries_of(names), 0.25) == names[90:]


@pytest.mark.parametrize(
    "form",
    [
        "cam_{}.{:04}",
        "gopro{}.{:04}",
        "gopro_{}.{:04}",
        "cam 0{} {:02}",
        "Cam 0{}-{:02}",
        "cam_{}_{:04}",
        "image_{}_{:06}",
    ],
)
@pytest.mark.parametrize("count", [15, 40])
def test_images_of_few_cameras_of_any_name_are_held_out_at_the_same_instants(form, count):
    names = [form.format(camera, k) for camera in range(2) for k in range(count)]
    last = [form.format(camera, k) for camera in range(2) for k in range(count * 4 // 5, count)]
    assert sorted(ends(entries_of(names), 0.2)) == last


@pytest.mark.parametrize("form", STEREO)
@pytest.mark.parametrize("sides", [("left", "right"), ("cam0", "cam1"), ("L", "R"), ("port", "stbd")])
@pytest.mark.parametrize("clip", ["", "reef"])
@pytest.mark.parametrize(
    ("left", "right"),
    [([100], [88]), ([100], [60]), ([25] * 3, [25] * 3), ([10] * 6, [9] * 6), ([30, 60], [60, 20])],
)
def test_images_of_a_stereo_pair_are_on_one_side(form, sides, clip, left, right):
    """Also where a camera stopped early, and where there are few images of each of many dives."""
    counts = dict(zip(sides, (left, right), strict=True))
    names = {
        form.format(d=d, side=side, k=k): (d, k)
        for side, of in counts.items()
        for d, count in enumerate(of)
        for k in range(count)
    }
    held = set(ends(entries_of(names, clip), 0.2))
    assert 0.1 * len(names) <= len(held) <= 0.4 * len(names)
    assert not {names[name] for name in held} & {names[name] for name in names.keys() - held}


@pytest.mark.parametrize("form", ["{side}/{k}", "dive1_{side}_{k}"])
@pytest.mark.parametrize("clip", ["", "reef"])
@pytest.mark.parametrize("first", [0, 1_700_000_000])
@pytest.mark.parametrize(
    "taken",
    [
        (range(100), range(50, 150)),
        (range(60), range(30, 100)),
        (range(10), range(2, 12)),
        ((3, 9, 15, 22, 31, 40, 47, 52, 60, 66), (31, 40, 47, 52, 60, 66, 71, 80, 88, 95)),
        (range(100), range(60), range(5000, 5100)),
        (range(100), range(150, 250)),
    ],
)
def test_what_one_camera_shows_at_its_end_is_not_learnt_from_by_another(form, clip, first, taken):
    """Cameras whose numbers overlap are on one clock in doubt, as in records of which a camera began later, and others
    beside them, on counters of their own, change nothing in that."""
    names = {form.format(side=f"cam{n}", k=first + k): k for n, of in enumerate(taken) for k in of}
    held = set(ends(entries_of(names, clip), 0.2))
    assert held
    assert not {names[name] for name in held} & {names[name] for name in names.keys() - held}


@pytest.mark.parametrize("clip", ["", "reef"])
def test_cameras_that_name_their_images_after_themselves_are_on_one_clock(clip):
    """And not apart, as imgR comes after imgL."""
    names = [f"{side}/img{side[0]}_{k}" for side, count in (("left", 100), ("right", 96)) for k in range(count)]
    held = ends(entries_of(names, clip), 0.2)
    assert {name for name in held if name[0] == "l"} == {f"left/imgl_{k}" for k in range(77, 100)}


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("left/left{:04}", "right/right{:04}"),
        ("dive1/left/L{:04}", "dive1/right/R{:04}"),
        ("L{}", "R{}"),
        ("dive1_left{:04}", "dive1_right{:04}"),
        ("{:04}L", "{:04}R"),
        ("frame{:04}_left", "frame{:04}_right"),
        ("left/frame{:04}", "right/frame{:04}"),
        ("cam_left/a{:04}", "cam_right/b{:04}"),
        ("left/22041234_{}", "right/22041235_{}"),
        ("cam1/1_{}", "cam2/2_{}"),
    ],
)
@pytest.mark.parametrize("clip", ["", "reef"])
@pytest.mark.parametrize("taken", [range(1, 101), range(1, 61), range(20, 101), range(40, 150)])
def test_cameras_are_on_one_clock_however_their_words_and_numbers_are_written(left, right, clip, taken):
    """With the number right behind a word, the word in folder and name, or a prefix of each camera's own."""
    names = {left.format(k): k for k in range(1, 101)} | {right.format(k): k for k in taken}
    mixed = random.Random(1).sample(sorted(names), len(names))
    held = set(ends(entries_of(mixed, clip), 0.2))
    assert 0.1 * len(names) <= len(held) <= 0.4 * len(names)
    assert not {names[name] for name in held} & {names[name] for name in names.keys() - held}


@pytest.mark.parametrize("sides", [("left", "right"), ("cam1", "cam2"), ("port", "starboard"), ("L", "R")])
@pytest.mark.parametrize(
    ("form", "clip"),
    [
        *((form, clip) for form in ("{}_{}", "dive_{1}_{0}", "2026/{}/f_{}", "GX-{}-00-{}") for clip in ("", "reef")),
        ("{}/GOPR{}", ""),
    ],
)
def test_of_cameras_that_number_images_each_by_itself_the_end_of_each_is_held_out(form, clip, sides):
    """And not most of one alone, on the ground that the other shows."""
    names = [
        form.format(side, k) for side, first in zip(sides, (1000, 5000), strict=True) for k in range(first, first + 50)
    ]
    assert ends(entries_of(names, clip), 0.2) == [*names[40:50], *names[90:]]


def test_numbers_after_a_word_for_a_camera_are_those_of_images():
    assert ends(entries_of([f"dive12_cam_{k:04}" for k in range(20)]), 0.1) == ["dive12_cam_0018", "dive12_cam_0019"]
    names = [f"cam-{year}-{k:03}" for year, count in ((2024, 100), (2025, 40)) for k in range(count)]
    assert ends(entries_of(names), 0.1) == [*names[90:100], *names[136:]]


@pytest.mark.parametrize("clip", ["", "reef"])
@pytest.mark.parametrize(
    "form",
    [
        "reef_2026-05-01T{h:02}h{m:02}m{s:02}",
        "dive_{m:02}m{s:02}",
        "{m}min{s:02}",
        "t_{m:02}min_{s:02}",
        "2026-05-01 {h:02}:{m:02}:{s:02}",
        "{m}:{s:02}",
        "{h},{m:02},{s:02}",
        "2026-05-01 at {h:02}.{m:02}.{s:02}",
        "13050{k:05}.{s:02}6667",
        "frame_{m}.{s:02}",
        "t{m}.{s:02}3333",
        "2026T{h:02}{m:02}{s:02}.033",
        "00h{m:02}m{s:02}s033",
        "reef 20260501 {h:02}-{m:02}-{s:02}",
        "Dive 3 {h:02}_{m:02}_{s:02}",
        "clip at {m:02}-{s:02}",
        "IMG_{m:04}_crop{s:02}",
        "IMG_{m:04}tile{s:02}",
    ],
)
def test_the_last_part_of_a_longer_time_is_no_time_and_what_is_before_it_no_camera(form, clip):
    """Else the end of each minute, or of each image that was cut up, would be held out, amid what was seen."""
    names = [form.format(h=12, m=k // 60, s=k % 60, k=k) for k in range(240)]
    assert ends(entries_of(names, clip), 0.25) == names[180:]


@pytest.mark.parametrize("clip", ["", "reef"])
@pytest.mark.parametrize("form", ["{side}_1714567890.{k:02}0000", "{side}_12h28m{k:02}s"])
@pytest.mark.parametrize("mixed", [False, True])
def test_names_alike_but_for_the_word_of_a_camera_are_of_one_instant_though_they_end_in_no_number(form, clip, mixed):
    pairs = [[form.format(side=side, k=k) for side in ("left", "right")] for k in range(40)]
    names = [name for row in (pairs if mixed else zip(*pairs, strict=True)) for name in row]
    assert sorted(ends(entries_of(names, clip), 0.1)) == sorted(name for pair in pairs[-4:] for name in pair)


@pytest.mark.parametrize("clip", ["", "reef"])
@pytest.mark.parametrize("form", ["reef {}", "frame.{}", "dive2frame{}", "GX010123frame{}", "dive.mp4.{}", "T1S{}"])
def test_a_number_behind_any_mark_or_word_is_a_time(form, clip):
    names = [form.format(k) for k in range(1, 41)]
    assert ends(entries_of(sorted(names), clip), 0.1) == names[36:]


@pytest.mark.parametrize(
    "form", ["dive{} frame{}", "dive{}.mp4.{}", "reef{}_{:03}", "reef {} {:03}", "camera{}.{:04}", "1.{}m_{:04}"]
)
def test_a_number_behind_another_that_is_no_part_of_a_time_is_one_of_its_own(form):
    names = [form.format(video, k) for video in (1, 2) for k in range(40)]
    assert ends(entries_of(names), 0.1) == [*names[36:40], *names[76:]]


@pytest.mark.parametrize("form", ["{}.{:04}", "{} {:04}", "{}cam0.{:04}", "{}-cam0frame{:04}", "{}_GoPro1f{:04}"])
def test_two_cameras_are_on_one_clock_whatever_is_before_their_numbers(form):
    names = [form.format(side, k) for side in ("left", "right") for k in range(100)]
    assert sorted(ends(entries_of(names, "reef"), 0.1)) == [*names[90:100], *names[190:]]


def drawn(k, digits=8):
    return f"{random.Random(str(k)).getrandbits(4 * digits):0{digits}x}"


@pytest.mark.parametrize("clip", ["", "dive"])
@pytest.mark.parametrize(
    "form",
    ["{drawn}-frame_{k:06}", "site/{drawn}-{k}", "GX_frame_{k:05}_jpg.rf.{drawn}", "{drawn}-f_{k}_PNG.rf.Ab{drawn}"],
)
def test_random_parts_that_programs_add_to_names_are_no_order(form, clip):
    """Such as those of Label Studio and Roboflow, in whichever order a file lists them."""
    names = [form.format(drawn=drawn(k), k=k) for k in range(95, 145)]
    mixed = random.Random(1).sample(names, len(names))
    assert ends(entries_of(mixed, clip), 0.2) == names[-10:]


def test_copies_of_an_image_by_augmentation_are_on_one_side():
    names = [f"frame_{k:03}_jpg.rf.{drawn((k, copy), 32)}" for k in range(40) for copy in range(3)]
    assert set(ends(entries_of(names), 0.1)) == set(names[-12:])


@pytest.mark.parametrize("first", [["20260501", "20260502"], ["0a1b2c3d", "1a2b3c4d"]])
def test_dates_and_videos_named_by_hex_digits_stay_apart(first):
    names = [f"{of}-{k:03}" for of, count in zip(first, (100, 60), strict=True) for k in range(count)]
    assert ends(entries_of(names), 0.1) == [*names[90:100], *names[154:]]
