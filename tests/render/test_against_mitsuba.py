"""The water model against Mitsuba 3: mean radiance of a checkered bottom, per water type and range."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.geometry import Array
from oysterbench.render.radiance import Daylight
from oysterbench.render.spectra import TABLE_WAVELENGTHS, WAVELENGTHS, jerlov_constituents
from oysterbench.render.water import Water, tabulate
from tests.helpers.mitsuba_water import path_traced, single_scattered

pytest.importorskip("mitsuba")

HELD = ("IB", "II", "III", "1C", "3C")  # to TOLERANCE; what is murkier is reported
REPORTED = ("5C", "7C")
TOLERANCE = 0.10
RANGES_M = (0.3, 0.6, 1.0, 2.0, 3.0, 4.0)
VIEWS = {"down": -1.0, "30 deg down": -0.5}
CAMERA_M = 3.0
ALBEDO = 0.2
DAYLIGHT = Daylight(sun_cosine=0.88, sky=0.35)
NOISE_SIGMAS = 2.0
SAMPLES = 1 << 18


def optics(kind: str) -> tuple[Array, Array]:
    """Absorption and scattering (3,) at 650, 550 and 450 nm, 1/m."""
    rows = np.searchsorted(WAVELENGTHS, TABLE_WAVELENGTHS)
    water = jerlov_constituents(kind)
    return water.absorption()[rows], water.scatter()[rows]


def model(kind: str) -> Water:
    """The tables for three single wavelengths in place of a camera's bands."""
    return tabulate(*optics(kind), np.eye(3), DAYLIGHT, 12.0)


def truth(kind: str, range_m: float, cosine: float, samples: int) -> tuple[Array, Array]:
    """Path-traced radiance (3,) and its standard error (3,); on a slant, the mean over the sun's side."""
    azimuths = (0.0,) if cosine == -1.0 else (0.0, np.pi / 2, np.pi, -np.pi / 2)
    runs = [
        path_traced(*optics(kind), CAMERA_M, range_m, cosine, ALBEDO, DAYLIGHT, samples // len(azimuths), azimuth, i)
        for i, azimuth in enumerate(azimuths)
    ]
    values, errors = (np.array(part) for part in zip(*runs, strict=True))
    return values.mean(axis=0), np.sqrt(np.sum(errors**2, axis=0)) / len(azimuths)


def test_bottom_in_coastal_water_is_as_bright_as_path_traced() -> None:
    water = model("3C")
    for range_m, cosine in ((0.6, -1.0), (2.0, -0.5)):
        traced, error = truth("3C", range_m, cosine, SAMPLES >> 2)
        seen = water.seen(ALBEDO, CAMERA_M, range_m, cosine)
        assert np.all(np.abs(seen / traced - 1.0) < TOLERANCE + NOISE_SIGMAS * error / traced)
        assert np.all(error / traced < 0.08)


def test_clear_water_has_the_bottom_alone() -> None:
    tiny = np.full(3, 1e-6)
    traced, error = path_traced(tiny, tiny, CAMERA_M, 1.0, -0.5, ALBEDO, DAYLIGHT, 1 << 14)
    assert traced == pytest.approx(ALBEDO, abs=3 * float(error.max()))
    assert single_scattered(tiny, tiny, CAMERA_M, 1.0, -0.5, ALBEDO, DAYLIGHT) == pytest.approx(ALBEDO, rel=1e-3)


@pytest.mark.slow
def test_mean_radiance_agrees_with_path_tracing_over_types_and_ranges(capsys: pytest.CaptureFixture[str]) -> None:
    """Within TOLERANCE, over Monte Carlo noise, for every wavelength, range and view of the types HELD."""
    lines = [
        "model / path traced (single scattering / path traced), and the largest Monte Carlo error of a row",
        f"{'type':5s}{'view':13s}{'nm':5s}" + "".join(f"{r:10.1f} m " for r in RANGES_M),
    ]
    misses = []
    for kind in (*HELD, *REPORTED):
        water = model(kind)
        for view, cosine in VIEWS.items():
            traces = [truth(kind, range_m, cosine, SAMPLES) for range_m in RANGES_M]
            traced, error = (np.array(part) for part in zip(*traces, strict=True))
            error /= traced
            ratio = np.array([water.seen(ALBEDO, CAMERA_M, r, cosine) for r in RANGES_M]) / traced
            once = [single_scattered(*optics(kind), CAMERA_M, r, cosine, ALBEDO, DAYLIGHT) for r in RANGES_M] / traced
            for i, wavelength in enumerate(TABLE_WAVELENGTHS):
                cells = "".join(f" {m:5.2f} ({o:4.2f})" for m, o in zip(ratio[:, i], once[:, i], strict=True))
                lines.append(f"{kind:5s}{view:13s}{wavelength:3.0f}  {cells}  +- {error[:, i].max():.2f}")
            if kind in HELD and np.any(np.abs(ratio - 1.0) > TOLERANCE + NOISE_SIGMAS * error):
                misses.append((kind, view, ratio))
    with capsys.disabled():
        print("\n" + "\n".join(lines))
    assert not misses
