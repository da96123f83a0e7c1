"""Curves in the report: their ticks and axes, what is drawn of them, and that they stand out from the page."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oysterbench.core import page
from oysterbench.report.axes import nice_ticks
from oysterbench.report.plots import Curve, map_plot, nees_plot, signed_plot, thin, time_plot


@given(st.floats(-1e6, 1e6), st.floats(1e-4, 1e6), st.integers(3, 9))
def test_ticks_are_round_distinct_and_few(low, size, count):
    ticks = nice_ticks(low, low + size, count)
    labels = [label for _, label in ticks]
    assert 1 <= len(ticks) <= count + 2
    assert len(set(labels)) == len(labels)
    assert all(low - 1e-6 * size <= value <= low + size * (1 + 1e-6) for value, _ in ticks)
    assert all(re.fullmatch("−?[0-9]+([.][0-9]{1,5})?", label) for label in labels)
    assert "−0" not in labels


def test_axes_of_a_map_are_equal():
    svg = map_plot([Curve("truth", np.array([0.0, 9.0]), np.array([-3.0, -3.5]), 0)], "side", "x [m]", "z [m]")
    texts = ElementTree.fromstring(svg).findall(".//text[@class='tick']")
    x = {float(t.text.replace("−", "-")): float(t.get("x")) for t in texts if t.get("text-anchor") == "middle"}
    y = {float(t.text.replace("−", "-")): float(t.get("y")) for t in texts if t.get("text-anchor") == "end"}
    per_metre_x = (x[max(x)] - x[min(x)]) / (max(x) - min(x))
    per_metre_y = (y[min(y)] - y[max(y)]) / (max(y) - min(y))
    assert per_metre_x == pytest.approx(per_metre_y, rel=0.01)


def test_an_estimate_that_runs_away_leaves_the_truth_visible():
    truth = Curve("truth", np.array([0.0, 10.0, 10.0]), np.array([0.0, 0.0, 5.0]), 0)
    svg = map_plot([truth, Curve("lost", np.array([0.0, 1e6]), np.array([0.0, 1e6]), 1)], "above", "x [m]", "y [m]")
    assert "lost leaves this plot" in svg
    first, last = re.search('class="c0" data-label="truth" d="M([0-9.]+) [0-9.]+L([0-9.]+)', svg).groups()
    assert float(last) - float(first) > 100


def test_errors_of_different_orders_are_drawn_on_a_logarithmic_axis():
    t = np.linspace(0, 10, 50)
    small, large = Curve("a", t, 0.01 + 0 * t, 1), Curve("b", t, 5 + t, 2)
    assert "logarithmic" in time_plot([small, large], "e", "t [s]", "error [m]", (0, 10))
    assert "logarithmic" not in time_plot([large], "e", "t [s]", "error [m]", (0, 10))


@pytest.mark.parametrize(("end", "last"), [(19.995, "20"), (20.0, "20"), (17.3, "15")])
def test_the_last_whole_second_gets_its_tick(end, last):
    t = np.linspace(0, end, 50)
    svg = time_plot([Curve("a", t, 1 + t, 1)], "e", "t [s]", "error [m]", (0.0, end))
    texts = ElementTree.fromstring(svg).findall(".//text[@class='tick']")
    assert [text.text for text in texts if text.get("text-anchor") == "middle"][-1] == last


def test_signed_errors_have_zero_in_the_middle_and_a_large_one_does_not_flatten_the_others():
    t = np.arange(5.0)
    small, large = Curve("small", t, 0.1 * np.sin(t), 1), Curve("large", t, 100.0 * t, 2)
    svg = signed_plot([small, large], "e", "t [s]", "error [m]", (0, 4))
    assert "large up to 4e+02" in svg
    assert 'data-label="large"' not in svg
    assert float(re.search(r'class="zero" d="M56.0 (\S+)H', svg).group(1)) == 32.0 + 75.0
    ys = [float(y) for y in re.findall(r"[ML]\S+ ([\d.]+)", re.search('data-label="small" d="([^"]*)"', svg).group(1))]
    assert ys[0] == 107.0
    assert min(ys) == pytest.approx(107.0 - 75.0 * max(small.y) / (1.08 * max(abs(small.y))), abs=0.01)
    assert "up to" not in signed_plot([small], "e", "t [s]", "error [m]", (0, 4))
    assert "up to" not in signed_plot([Curve("none", t, 0 * t, 1)], "e", "t [s]", "error [m]", (0, 4))


def test_an_estimate_that_is_far_too_sure_stays_in_the_frame_and_is_named():
    t = np.arange(5.0)
    sure, sane = Curve("sure", t, 1e12 + t, 1), Curve("sane", t, np.full(5, 3.0), 2)
    svg = nees_plot([sure, sane], "NEES", "t [s]", "e2 / covariance", (0, 4), 3)
    assert "sure leaves this plot" in svg
    top, height = map(float, re.search(r'class="frame" x="\S+" y="(\S+)" width="\S+" height="(\S+)"', svg).groups())
    ys = [float(y) for data in re.findall(' d="(M[^"]*L[^"]*)"', svg) for y in re.findall(r"[ML]\S+ (-?[\d.]+)", data)]
    assert top == min(ys) < max(ys) < top + height
    assert "leaves" not in nees_plot([sane], "NEES", "t [s]", "e2 / covariance", (0, 4), 3)


def test_a_curve_is_lifted_where_it_is_broken():
    t = np.arange(5.0)
    svg = time_plot([Curve("a", t, np.array([1.0, 2, np.nan, 3, 4]), 1)], "e", "t [s]", "error [m]", (0, 4))
    assert re.search('class="c1" data-label="a" d="([^"]*)"', svg).group(1).count("M") == 2


def test_thinning_keeps_peaks_and_breaks():
    t = np.arange(100_000.0)
    y = np.sin(t / 1000)
    y[54_321], y[70_000] = 9.0, np.nan
    thinned = thin(Curve("a", t, y, 1))
    assert len(thinned.x) < 1000
    assert np.nanmax(thinned.y) == 9.0
    assert np.isnan(thinned.y).sum() == 1


def luminance(colour: str) -> float:
    """Relative luminance (WCAG 2.2)."""
    colour = colour.lstrip("#")
    colour = "".join(c * 2 for c in colour) if len(colour) == 3 else colour
    channels = np.array([int(colour[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(a: str, b: str) -> float:
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_text_and_curves_stand_out(scheme):
    blocks = re.findall(r":root \{(.*?)\}", page.STYLE, re.DOTALL)
    colours = dict(re.findall(r"--(\w+): (#\w+);", blocks[scheme]))
    assert {f"c{i}" for i in range(page.STYLES + 1)} <= colours.keys()
    for text in ("ink", "soft", "warn"):
        for ground in ("bg", "card"):
            assert contrast(colours[text], colours[ground]) >= 4.5, (text, ground)
    assert contrast(colours["ink"], colours["best"]) >= 4.5
    for i in range(page.STYLES + 1):
        assert contrast(colours[f"c{i}"], colours["card"]) >= 3, f"c{i}"


def test_every_style_has_a_dash_pattern_of_its_own():
    dashes = re.findall(r"\.c[1-9] \{.*?dasharray: ([^;]+);", page.STYLE)
    assert len(set(dashes)) == len(dashes) == page.STYLES
