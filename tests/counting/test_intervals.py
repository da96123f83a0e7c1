"""Intervals over pictures hold the mean as often as they say; blocks of time, and what they are for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from oysterbench.core.streams import stream
from oysterbench.counting.intervals import block_labels, likeness, ratio
from oysterbench.counting.measure import PictureCount
from oysterbench.counting.survey import survey
from oysterbench.evaluate.exact import count_interval, share_interval


def picture(name, oysters=1, time_s=None, **further):
    values = {"cut": 0, "live": 0, "dead": 0, "cover": 0.1, "area_m2": None, "novelty": None, **further}
    index = None if time_s is None else round(10 * time_s)
    return PictureCount(name, name, 160, 120, oysters, **values, index=index, time_s=time_s)


def frames(name, count, rate_hz=1.0, counts=None):
    return [picture(f"{name}/{k:06d}", 1 if counts is None else counts[k], time_s=k / rate_hz) for k in range(count)]


def test_pictures_are_blocks_of_their_own_and_frames_of_a_video_blocks_of_ten_seconds():
    labels = block_labels([picture("a"), picture("b"), *frames("d.mp4", 25), *frames("e.mp4", 3)])
    assert labels.tolist() == [0, 1, *[2] * 10, *[3] * 10, *[4] * 5, 5, 5, 5]


def test_neighbours_are_put_together_within_a_folder_and_a_video():
    pictures = [picture(name) for name in ("x/1", "x/2", "x/3", "y/1")]
    assert block_labels([*pictures, *frames("d.mp4", 3)], 2).tolist() == [0, 0, 1, 2, 3, 3, 4]


def test_a_ratio_is_that_of_the_sums_whatever_the_blocks():
    above, below = [1.0, 2.0, 6.0, 3.0], [1.0, 1.0, 2.0, 0.0]
    for labels in ([0, 1, 2, 3], [0, 0, 1, 1], [0, 0, 0, 0]):
        assert ratio(above[:3], below[:3], np.array(labels[:3])).value == pytest.approx(9 / 4)
    assert math.isnan(ratio([1.0], [0.0], np.array([0])).value)
    assert ratio([], [], np.array([], dtype=int)).interval.reason == "there is nothing to count"


def test_fewer_than_six_blocks_have_no_interval_and_say_so():
    found = ratio([1.0] * 5, [1.0] * 5, np.arange(5), "picture")
    assert found.value == 1.0
    assert found.interval.reason.startswith("5 pictures: no 95% interval")


def correlated(random, count=120, span=12):
    """Counts over ground that changes every `span` frames."""
    return np.repeat(random.poisson(20, count // span), span) + random.poisson(2, count)


def test_blocks_hold_the_mean_of_a_video_where_single_frames_do_not():
    held = {"frames": 0, "blocks": 0}
    tries = 150
    for k in range(tries):
        counts = correlated(stream(k, b"", "test", "blocks"))
        for name, labels in (("frames", np.arange(120)), ("blocks", np.arange(120) // 12)):
            interval = ratio(counts.tolist(), [1.0] * 120, labels).interval
            held[name] += interval.low <= 22.0 <= interval.high
    assert held["blocks"] / tries > 0.88
    assert held["frames"] / tries < 0.6


def test_neighbours_that_are_alike_are_told_of_and_chance_is_not():
    random = stream(1, b"", "test", "alike")
    assert likeness(correlated(random).tolist(), np.arange(120)) > 0.5
    assert math.isnan(likeness(random.poisson(20, 120).tolist(), np.arange(120)))
    assert math.isnan(likeness([1.0, 2.0, 3.0], np.arange(3)))
    assert math.isnan(likeness([2.0] * 30, np.arange(30)))


def test_a_survey_has_what_is_known_and_leaves_out_the_rest():
    pictures = [
        picture(f"{k}", oysters=k, live=k, dead=1, area_m2=0.25, cut=2, measured=1, length_mm=50.0 + k)
        for k in range(2, 10)
    ]
    found = survey("dive", "m", pictures, {"x": "no"})
    values = {one.key: one.ratio.value for one in found.measures}
    assert values["oysters"] == pytest.approx(5.5)
    assert values["cover"] == pytest.approx(10)
    assert values["live"] == pytest.approx(100 * 44 / 52)
    assert values["per_m2"] == pytest.approx((44 - 8) / 2)
    assert values["length_mm"] == pytest.approx(55.5)
    assert all(
        one.ratio.interval.low < one.ratio.value < one.ratio.interval.high
        for one in found.measures
        if one.key != "cover"
    )
    assert [one.key for one in survey("dive", "m", [picture("a", cover=None)], {}).measures] == ["oysters"]
    assert survey("dive", "m", [], {}).measures == ()


def test_a_summary_has_no_number_that_is_not_one():
    plain = survey("dive", "m", [picture("a", novelty=3.0), picture("b", novelty=1.2)], {"c": "broken"}).as_plain()
    assert plain["unlike"] == ["a", "b"], "the most unlike first"
    assert plain["measures"]["oysters"]["low"] is None
    assert plain["measures"]["oysters"]["reason"]
    assert plain["failures"] == {"c": "broken"}


def intervals(pictures, neighbours=None):
    return {one.key: one.ratio.interval for one in survey("dive", "m", pictures, {}, neighbours).measures}


def test_no_oyster_in_any_picture_leaves_an_upper_end_and_cover_without_an_interval():
    found = intervals([picture(f"{k}", 0, cover=0.0, area_m2=0.12) for k in range(10)])
    # Of none counted, the mean may be up to 3.7 (Poisson, 97.5 %), as on a map.
    assert (found["oysters"].low, found["per_m2"].low) == (0.0, 0.0)
    assert found["oysters"].high == pytest.approx(3.689 / 10, rel=1e-3)
    assert found["per_m2"].high == pytest.approx(3.689 / 1.2, rel=1e-3)
    assert found["cover"].reason == "where all 10 images have the same value, resampling gives no 95% interval"


def test_where_all_are_alive_or_all_dead_the_share_is_not_certain():
    alive = intervals([picture(f"{k}", 2, live=2) for k in range(10)])["live"]
    dead = intervals([picture(f"{k}", 2, dead=2) for k in range(10)])["live"]
    assert (alive.low, alive.high) == (pytest.approx(100 * 0.025 ** (1 / 20)), 100.0)  # Clopper & Pearson, of 20
    assert (dead.low, dead.high) == (0.0, pytest.approx(100 - alive.low))


def test_frames_of_the_same_ground_are_no_further_evidence_that_there_is_no_oyster():
    found = intervals(frames("d.mp4", 60, counts=[0] * 60))["oysters"]
    assert found.high == pytest.approx(3.689 / 6, rel=1e-3), "six blocks of 10 s"
    assert intervals([picture(f"{k}", 0) for k in range(60)], 10)["oysters"] == found


@pytest.mark.parametrize("count", [60, 63, 67])
def test_blocks_that_differ_by_rounding_alone_are_equal(count):
    found = intervals([replace(one, area_m2=0.12) for one in frames("d.mp4", count, counts=[3] * count)])["per_m2"]
    assert found.low < 18, "exact, of 3 on 0.12 m2 in each of 6 or 7 blocks: 25 per m2"
    assert found.high > 35


@pytest.mark.parametrize("count", range(1, 9))
def test_a_few_oysters_have_an_upper_end_above_that_of_none_and_above_the_exact_one(count):
    found = intervals([picture(f"{k}", int(k < count)) for k in range(60)])["oysters"]
    low, high = count_interval(count, count)
    assert found.low <= low / 60
    assert found.high >= high / 60 > 3.689 / 60


def test_of_a_few_dead_ones_the_share_has_the_exact_ends_as_well():
    pictures = [picture(f"{k}", 5, live=5 - (k == 0), dead=int(k == 0)) for k in range(60)]
    found = intervals(pictures)["live"]
    low, high = share_interval(299, 300)
    assert (found.low, found.high) == (pytest.approx(100 * low), pytest.approx(max(100 * high, 100.0)))


@pytest.mark.parametrize(("mean", "images"), [(0.05, 6), (0.05, 20), (0.3, 6), (0.06, 60)])
def test_intervals_hold_the_mean_of_sparse_ground(mean, images):
    random, tries, held = stream(images, b"", "test", "sparse"), 100, 0
    for _ in range(tries):
        interval = intervals([picture(f"{k}", int(n)) for k, n in enumerate(random.poisson(mean, images))])["oysters"]
        held += interval.low <= mean <= interval.high
    assert held / tries >= 0.9
