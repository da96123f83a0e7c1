"""References for the water model: Mitsuba 3 path traces, and single scattering alone.

Both see a level, checkered, matte bottom in homogeneous water below a sun and a sky that fills Snell's cone, matched in
index at the surface, as render/radiance.py has it. A white matte surface under surface daylight has radiance 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.render.radiance import WATER_INDEX, Daylight
from oysterbench.render.water import ASYMMETRY

HALF_WIDTH_M = 150.0  # of the water body: many times what light travels in any water that scatters
CHECK_M = 0.02
CONTRAST = 0.5
PIXELS = 8
FIELD_DEG = 8.0


def path_traced(
    a: Array,
    b: Array,
    camera_m: float,
    range_m: float,
    cosine: float,
    albedo: float,
    daylight: Daylight,
    samples: int,
    azimuth: float = 0.0,
    seed: int = 0,
) -> tuple[Array, Array]:
    """Mean radiance (3,) of the bottom seen from camera_m deep over range_m, and its standard error (3,).

    a, b (3,): three wavelengths at once, by spectral multiple importance sampling. cosine: of the view ray with the
    zenith; azimuth: of the view ray from the sun's, rad.
    """
    import mitsuba as mi

    if mi.variant() != "scalar_rgb":
        mi.set_variant("scalar_rgb")
    slope = np.sqrt(1.0 - cosine**2)
    toward = np.array([slope * np.cos(azimuth), slope * np.sin(azimuth), cosine])
    origin = np.array([0.31, 0.17, -camera_m])
    up = [0, 0, 1] if slope > 0.01 else [1, 0, 0]
    scene = _scene(mi, a, b, camera_m - cosine * range_m, albedo, daylight)
    scene["sensor"] = {
        "type": "perspective",
        "fov": FIELD_DEG,
        "to_world": mi.ScalarTransform4f().look_at(origin=origin.tolist(), target=(origin + toward).tolist(), up=up),
        "medium": {"type": "ref", "id": "water"},
        "film": {
            "type": "hdrfilm",
            "width": PIXELS,
            "height": PIXELS,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": samples // PIXELS**2},
    }
    scene["integrator"] = {"type": "volpathmis", "max_depth": 400, "rr_depth": 60}
    image = np.pi * np.array(mi.render(mi.load_dict(scene), seed=mi.UInt32(seed)), dtype=np.float64)
    return image.mean(axis=(0, 1)), image.std(axis=(0, 1)) / PIXELS


def _scene(mi: Any, a: Array, b: Array, bottom_m: float, albedo: float, daylight: Daylight) -> dict[str, Any]:
    transform = mi.ScalarTransform4f
    c = a + b
    sun = np.array([np.sqrt(1.0 - daylight.sun_cosine**2), 0.0, daylight.sun_cosine])
    height = (bottom_m + 0.5) / 2
    checks = HALF_WIDTH_M / CHECK_M
    scene: dict[str, Any] = {
        "type": "scene",
        "body": {
            "type": "cube",
            "to_world": transform().translate([0, 0, -height]).scale([HALF_WIDTH_M, HALF_WIDTH_M, height]),
            "bsdf": {"type": "null"},
            "interior": {
                "type": "homogeneous",
                "id": "water",
                "albedo": _rgb(b / c),
                "sigma_t": _rgb(c / c.max()),
                "scale": float(c.max()),
                "phase": {"type": "hg", "g": ASYMMETRY},
            },
        },
        "bottom": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0, -bottom_m]).scale([HALF_WIDTH_M, HALF_WIDTH_M, 1]),
            "bsdf": {
                "type": "diffuse",
                "reflectance": {
                    "type": "checkerboard",
                    "color0": _rgb(np.full(3, albedo * (1 - CONTRAST))),
                    "color1": _rgb(np.full(3, albedo * (1 + CONTRAST))),
                    "to_uv": transform().scale([checks, checks, 1]),
                },
            },
        },
        "sky": {
            "type": "envmap",
            "bitmap": mi.Bitmap(_sky(daylight.sky)),
            "to_world": transform().rotate([1, 0, 0], 90),
        },
    }
    if daylight.sky < 1:
        scene["sun"] = {
            "type": "directional",
            "direction": (-sun).tolist(),
            "irradiance": _rgb(np.full(3, (1 - daylight.sky) / daylight.sun_cosine)),
        }
    return scene


def _sky(irradiance: float, rows: int = 512) -> NDArray[np.float32]:
    """A latitude-longitude picture of an even sky in Snell's cone that gives a horizontal plane this irradiance."""
    zenith = (np.arange(rows) + 0.5) / rows * np.pi
    image = np.zeros((rows, 2 * rows, 3), dtype=np.float32)
    image[np.cos(zenith) > np.sqrt(1.0 - WATER_INDEX**-2)] = irradiance / (np.pi * WATER_INDEX**-2)
    return image


def _rgb(values: Array) -> dict[str, Any]:
    return {"type": "rgb", "value": values.tolist()}


def single_scattered(
    a: Array, b: Array, camera_m: float, range_m: float, cosine: float, albedo: float, daylight: Daylight
) -> Array:
    """The same radiance (3,) when light is scattered once at most, mean over azimuth."""
    c = a + b
    edge = np.sqrt(1.0 - WATER_INDEX**-2)
    cosines = np.append(edge + (np.arange(64) + 0.5) / 64 * (1.0 - edge), daylight.sun_cosine)
    power = np.append(daylight.sky * cosines[:-1] / cosines[:-1].sum(), 1.0 - daylight.sky)  # on a level plane

    def left(depth_m: Array) -> Array:
        """Irradiance (N, 65, 3) on a level plane at depths (N,), from each direction."""
        return power[:, None] * np.exp(-depth_m[:, None, None] * c / cosines[:, None])

    turn = cosine * cosines[:, None] + np.sqrt((1 - cosine**2) * (1 - cosines[:, None] ** 2)) * np.cos(
        (np.arange(360) + 0.5) / 180 * np.pi
    )
    g = ASYMMETRY
    phase = ((1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * turn) ** 1.5)).mean(axis=1)
    steps = (np.arange(400) + 0.5) / 400 * range_m
    source = b * np.einsum("nkc,k->nc", left(camera_m - cosine * steps), phase / cosines)
    veil = np.pi * np.sum(np.exp(-steps[:, None] * c) * source, axis=0) * range_m / 400
    bottom = left(np.array([camera_m - cosine * range_m]))[0].sum(axis=0)
    return albedo * bottom * np.exp(-c * range_m) + veil
