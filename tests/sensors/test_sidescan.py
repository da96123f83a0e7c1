"""The side-scan sonar: geometry, shadows, statistics and gain of its pings; and the way of a ping to a picture."""

from __future__ import annotations

import base64
import csv
import json
import re

import cv2
import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import RecipeError
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe, parse_split
from oysterbench.report.viewer.page import view_page
from oysterbench.sensors import echoes
from oysterbench.sensors.panels import BACKGROUND
from oysterbench.sensors.sidescan import KIND, SIDES, SidescanPing, SidescanRecipe, SidescanSonar, first_return
from oysterbench.sequence.cut import is_public
from oysterbench.sequence.export import export_sequence
from oysterbench.simulation.generate import generate_split
from tests.helpers.acoustic_scenes import at, ball, caster_over
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

SITE = SiteRecipe()
STREAMS = Streams(9)
BLOCK = """
[[sidescan]]
name = "side"
rate_hz = 10.0
bins = 128
max_range_m = 4.0
dropout = 0.1
clock_offset_ms = 3.0
"""


def towed(**changes) -> SidescanRecipe:
    return SidescanRecipe(**{"name": "side", "rate_hz": 10.0, "min_range_m": 0.1, "max_range_m": 12.0, **changes})


def heard_by(caster, place, side="port", n=1, **changes):
    """Ranges and mean expected power of n pings."""
    sonar = SidescanSonar(caster, towed(**changes), SITE)
    return sonar.ranges, np.mean([sonar.listen(place, side, STREAMS.at(k))[0] for k in range(n)], axis=0)


@pytest.mark.parametrize("altitude", [1.5, 3.0])
def test_the_column_of_water_ends_at_the_slant_range_of_the_altitude(altitude):
    sonar = SidescanSonar(caster_over(10.0), towed(bins=1200, bandwidth_khz=200.0), SITE)
    for side in SIDES:
        power, _ = sonar.listen(at(0, 0, altitude - 10.0), side, STREAMS)
        step = sonar.ranges[1] - sonar.ranges[0]
        first = sonar.ranges[np.argmax(power > 0.05 * power.max())]
        assert first == pytest.approx(altitude, abs=2 * step + 0.01)
    ping = sonar.ping(at(0, 0, altitude - 10.0), STREAMS, 0)
    assert sonar.ranges[first_return(ping.port)] == pytest.approx(altitude, abs=0.1)


def test_each_side_hears_its_own_half():
    caster = caster_over(40.0, ball(0, 4.0, -9.0, 0.3))
    _, port = heard_by(caster, at(0, 0, -8.0), "port")
    _, starboard = heard_by(caster, at(0, 0, -8.0), "starboard")
    assert port.sum() > 0
    assert starboard.sum() == 0
    _, turned = heard_by(caster, at(0, 0, -8.0, yaw_deg=180.0), "starboard")
    assert turned.sum() == pytest.approx(port.sum(), rel=0.1)


def test_the_beam_is_narrow_along_the_track():
    caster = caster_over(60.0, ball(0, 6.0, -11.0, 0.05))
    off = np.hypot(6.0, 3.0) * np.tan(np.radians(1.5))
    echo = [heard_by(caster, at(x, 0, -8.0), n=8, beam_deg=3.0)[1].sum() for x in (0.0, off, 0.5)]
    assert echo[1] / echo[0] == pytest.approx(0.5, abs=0.12), "half the power at half the beam's width"
    assert echo[2] == 0


def test_a_fan_is_loudest_along_its_tilted_axis():
    def at_depression(degrees: float) -> float:
        angle = np.radians(degrees)
        thing = ball(0, 5 * np.cos(angle), -10.0 - 5 * np.sin(angle), 0.1)
        return heard_by(caster_over(80.0, thing), at(0, 0, -10.0), n=8)[1].sum()

    axis = at_depression(30.0)
    for off in (-25.0, 25.0):
        assert at_depression(30.0 + off) / axis == pytest.approx(0.5, abs=0.08)


def test_a_shadow_is_as_long_as_the_height_of_its_object_makes_it():
    """A thing as high as h, at slant range r of a sonar at altitude H, shades r h / (H - h): by similar triangles."""
    altitude, distance, radius = 3.0, 5.0, 0.2
    caster = caster_over(10.0, ball(0, distance, -10.0 + radius, radius))
    place = at(0, 0, altitude - 10.0)
    keys = {"bins": 1200, "bandwidth_khz": 200.0, "beam_deg": 0.3}
    r, shaded = heard_by(caster, place, n=4, **keys)
    _, clear = heard_by(caster_over(10.0), place, n=4, **keys)
    share = shaded / np.maximum(clear, 1e-30)
    slant = np.hypot(distance, altitude - radius)
    tangent = np.arctan2(altitude - radius, distance) - np.arcsin(radius / slant)
    end = altitude / np.sin(tangent)
    dark = r[(share < 0.5) & (r > slant) & (r < end + 1.0)]
    assert dark.max() == pytest.approx(end, abs=0.08)
    length = dark.max() - slant
    assert length == pytest.approx(slant * 2 * radius / (altitude - 2 * radius), rel=0.1)
    assert share[(r > slant - radius - 0.05) & (r < slant)].max() > 2, "and it is brighter than the bottom itself"
    assert np.median(share[(r > end + 0.2) & (r < end + 1.0)]) == pytest.approx(1.0, abs=0.1)


def test_speckle_is_rayleigh_about_the_expected_power():
    """Of a Rayleigh amplitude the standard deviation over the mean is sqrt(4 / pi - 1)."""
    sonar = SidescanSonar(caster_over(10.0), towed(bins=100), SITE)
    place = at(0, 0, -7.0)
    far = sonar.ranges > 5.0
    pings = np.stack([sonar.ping(place, STREAMS, k).port[far] for k in range(200)]).astype(float)
    relative = pings / pings.mean(axis=0)
    assert relative.std() == pytest.approx(np.sqrt(4 / np.pi - 1), rel=0.03)
    assert np.mean(relative**4) / np.mean(relative**2) ** 2 == pytest.approx(2.0, rel=0.06)


def test_gain_makes_the_echo_of_one_bottom_even_over_the_range():
    """Undone are spreading and absorption; left are the area of the bottom in a bin, Lambert's law and the beam."""
    sonar = SidescanSonar(caster_over(10.0), towed(bins=200), SITE)
    place, altitude = at(0, 0, -7.0), 3.0
    power = np.mean([sonar.listen(place, "port", STREAMS.at(k))[0] for k in range(8)], axis=0)
    _, loss = sonar.listen(place, "port", STREAMS)
    r = sonar.ranges
    gained = power * echoes.time_varying_gain(sonar.recipe, loss) ** 2
    # cos^2 of the incidence is (H / r)^2, the area of a bin r dr dpsi / cos(grazing) ~ r, r^-4 is undone by the gain.
    elevation = np.radians(30.0) - np.arcsin(np.minimum(altitude / r, 1.0))
    pattern = np.sinc(0.442946 / np.sin(np.radians(25.0)) * np.sin(elevation)) ** 2
    expected = (altitude / r) ** 2 * r * pattern / np.sqrt(1 - np.minimum(altitude / r, 0.999) ** 2)
    inside = (r > 4.0) & (r < 11.0)
    ratio = gained[inside] / expected[inside]
    assert np.ptp(ratio / ratio.mean()) < 0.25
    low, high = (ratio[s].mean() for s in (slice(None, 20), slice(-20, None)))
    assert high / low == pytest.approx(1.0, abs=0.06)


def test_open_water_is_noise_only():
    sonar = SidescanSonar(caster_over(80.0), towed(tvg=False, noise_db=-90.0), SITE)
    power, _ = sonar.listen(at(0, 0, -5.0), "port", STREAMS)
    assert power.max() == 0
    amplitudes = sonar.ping(at(0, 0, -5.0), STREAMS, 0).port.astype(float) * echoes.amplitude_step(sonar.recipe)
    assert np.mean(amplitudes**2) == pytest.approx(1e-9, rel=0.15)


def test_a_ping_is_the_same_each_time_and_its_sides_and_the_next_ping_are_not():
    sonar = SidescanSonar(caster_over(10.0), towed(), SITE)
    first, again, other = (sonar.ping(at(0, 0, -7.0), STREAMS, k) for k in (3, 3, 4))
    assert np.array_equal(first.line, again.line)
    assert not np.array_equal(first.port, first.starboard)
    assert not np.array_equal(first.port, other.port)


def test_a_line_that_is_no_ping_is_refused():
    from oysterbench.core.ros import echo_image

    calibration = KIND.read_calibration(KIND.calibrate(towed(), SITE))
    for shape in ((1, 5), (2, 2 * len(calibration.ranges_m))):
        with pytest.raises(ValueError, match=r"side: expected .* x 1 amplitudes, as its calibration says, got"):
            KIND.decode("side", calibration, echo_image(1, "side_link", np.zeros(shape, dtype=np.uint16)))


def test_what_no_single_key_can_say_is_checked():
    with pytest.raises(RecipeError, match=r"'sidescan.max_range_m': expected more than min_range_m = 5, got 4"):
        parse_split(TINY_SPLIT, "tiny.toml", TINY_RIG + BLOCK + "min_range_m = 5.0\n")


@pytest.fixture(scope="module")
def split():
    return parse_split(TINY_SPLIT, "tiny.toml", TINY_RIG + BLOCK)


@pytest.fixture(scope="module")
def path(split, tmp_path_factory):
    return generate_split(split, tmp_path_factory.mktemp("side"))["tiny-01"]


@pytest.fixture(scope="module")
def sequence(path):
    return oysterbench.open(path)


def test_what_was_measured_is_read(sequence, split):
    from oysterbench.simulation.simulated_sequence import build_sequence

    simulated = build_sequence(split, "tiny-01", b"")
    sonar = SidescanSonar(simulated.caster, split.rig.of(SidescanRecipe)[0], SITE, simulated.recipe.reef.bottom)
    start = sequence.truth().stamps_ns[0]
    pings = list(sequence.measurements("side"))
    assert 10 < len(pings) < 25, "some of 25 are lost"
    for ping in pings[:3]:
        index = round((ping.stamp_ns - start - 3_000_000) / 1e8)
        (body,) = simulated.bodies(np.array([index / 10.0]))
        made = sonar.ping(body, simulated.streams, index, ping.stamp_ns)
        assert isinstance(ping, SidescanPing)
        assert np.array_equal(ping.port, made.port)
        assert np.array_equal(ping.starboard, made.starboard)
    assert sequence.calibration("side").ranges_m == pytest.approx(sonar.ranges)
    assert {type(item) for item in sequence.stream("side")} >= {SidescanPing}


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_the_workers(split, path, tmp_path):
    assert generate_split(split, tmp_path, workers=2)["tiny-01"].read_bytes() == path.read_bytes()


def test_another_sensor_changes_no_others_bytes(sequence, tmp_path):
    bare = oysterbench.open(generate_split(parse_split(TINY_SPLIT, "t.toml", TINY_RIG), tmp_path)["tiny-01"])
    for a, b in zip(sequence.imu(), bare.imu(), strict=True):
        assert np.array_equal(a.gyro, b.gyro)
    for a, b in zip(sequence.images("cam_front"), bare.images("cam_front"), strict=True):
        assert np.array_equal(a.pixels, b.pixels)


def test_a_method_and_a_hidden_split_have_it_too(sequence):
    assert len(list(sequence.for_method().measurements("side"))) == len(list(sequence.measurements("side")))
    assert is_public("/side/ping")


def test_its_table_has_the_first_echo_of_the_bottom(sequence):
    table = sequence.frame("/side/ping")
    ranges = sequence.calibration("side").ranges_m
    truth = sequence.truth().at(table.index.to_numpy() - 3_000_000)
    altitude = 3.0 + truth.positions[:, 2]
    first = ranges[table["port_first_bin"].to_numpy().astype(int)]
    assert np.median(np.abs(first - altitude)) < 0.2
    assert (table["starboard_mean"] > 0).all()


def test_the_viewer_has_a_waterfall_of_it(sequence):
    page = view_page(sequence)
    assert 'alt="side, slant range to 4.0 m, port on the left"' in page
    data = json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.S)[1])
    last = cv2.imdecode(np.frombuffer(base64.b64decode(data["panels"][-1]["frames"][-1]), np.uint8), cv2.IMREAD_COLOR)
    lines = len(list(sequence.measurements("side")))
    brightness = last.astype(int).sum(axis=-1)
    assert brightness[1 : lines - 1, [20, -20]].mean() > 2 * brightness[1 : lines - 1, 195:205].mean()
    assert brightness[lines + 8 :].max() < 3 * (BACKGROUND + 10), "nothing below the first ping"


def test_it_is_exported_as_a_waterfall_with_poses(sequence, tmp_path):
    folder, notes = export_sequence(sequence, "waterfall", tmp_path / "out")
    pings = list(sequence.measurements("side"))
    picture = cv2.imread(str(folder / "side.png"), cv2.IMREAD_UNCHANGED)
    assert picture.dtype == np.uint16
    assert np.array_equal(picture, np.stack([ping.line for ping in pings]))
    with open(folder / "side.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["stamp_ns"]) for row in rows] == [ping.stamp_ns for ping in pings]
    assert float(rows[0]["z"]) == pytest.approx(sequence.truth().positions[0, 2], abs=0.1)
    assert notes == [f"side.png: {len(pings)} pings, 128 bins of 30.5 mm to each side from 0.12 m"]
    blind, _ = export_sequence(sequence, "waterfall", tmp_path / "blind", truth=False)
    assert (blind / "side.csv").read_text().splitlines()[0] == "stamp_ns"
