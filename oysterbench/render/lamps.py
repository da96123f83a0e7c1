"""Lamps of the vehicle: their illumination, and the beams that the water scatters into the view (single scattering).

The beams are summed on a coarse grid of view rays and ranges (Wronski 2014, "Volumetric fog"), from which every pixel
reads its value at its own range. Along a ray at distance D from a lamp, the integral of 1 / r^2 over a segment is
exact: (atan(x1 / D) - atan(x0 / D)) / D; everything else is evaluated at the middle of the segment.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.recipe import LampRecipe
from oysterbench.render.optics import Lamps, Optics
from oysterbench.render.tables import look_up
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.turbidity import decays
from oysterbench.render.view import CameraView, ray_start, ray_through
from oysterbench.render.water import IMAGE_CONE_RAD, Water, forward_share
from oysterbench.render.way import interpolate, node_at

wp.set_module_options(KERNEL_OPTIONS)


DAYLIGHT_LUX = 100_000.0  # full sun and sky on level ground, which an irradiance of 1 stands for
BEAM_PIXELS = 8  # cell width of the grid of beams
BEAM_NODES = 32
LONGEST_BEAM_M = 8.0
LEFT_NODES = 512
LEAST_DISTANCE_M = wp.constant(0.02)  # smallest distance of a view ray from a lamp: its glass
HALF_PI = wp.constant(1.5707963267948966)
PI = wp.constant(3.141592653589793)


def lamp_spread(water: Water) -> Array:
    """Attenuation (3,) of a lamp's light, 1/m; light scattered forward still lights the scene."""
    return water.absorption + (1.0 - forward_share(IMAGE_CONE_RAD)) * water.scattering


def build_lamps(
    recipes: Sequence[LampRecipe], factor: float, water: Water, shape: tuple[int, int], device: str
) -> Lamps:
    """Build the lamps of a rig on a device, not yet placed, for images of `shape` (H, W) px; factor: on intensities."""
    lamps = Lamps()
    lamps.count = len(recipes) if factor > 0 else 0
    if not lamps.count:
        return lamps
    power = np.array([np.array(lamp.colour) * lamp.intensity_cd * factor / DAYLIGHT_LUX for lamp in recipes])
    half, edge = (np.deg2rad([getattr(lamp, key) for lamp in recipes]) for key in ("half_angle_deg", "edge_deg"))
    lamps.power = wp.array(np.round(power, 9).astype(np.float32), dtype=wp.vec3, device=device)
    inner, outer = (np.round(np.cos(np.clip(half + side * edge / 2, 0, np.pi)), 7) for side in (-1, 1))
    lamps.inner = wp.array(inner.astype(np.float32), dtype=wp.float32, device=device)
    lamps.outer = wp.array(outer.astype(np.float32), dtype=wp.float32, device=device)
    spread = lamp_spread(water)
    longest = float(np.clip(12.0 / spread.min(), 4.0, 60.0))
    distances = np.linspace(0.0, longest, LEFT_NODES)
    lamps.left = wp.array(
        np.round(np.exp(-distances[:, None] * spread), 7).astype(np.float32), dtype=wp.vec3, device=device
    )
    lamps.left_step = float(distances[1])
    lamps.reach = float(np.clip(6.0 / spread.min(), 1.0, LONGEST_BEAM_M))
    cells = (-(-shape[0] // BEAM_PIXELS) + 1, -(-shape[1] // BEAM_PIXELS) + 1, BEAM_NODES)
    lamps.beams = wp.zeros(cells, dtype=wp.vec3, device=device)
    return lamps


def without_water(lamps: Lamps, device: str) -> Lamps:
    """Return the same lamps without water, so that no light is lost on the way."""
    clear = Lamps()
    clear.count = lamps.count
    if lamps.count:
        clear.power, clear.inner, clear.outer, clear.reach = lamps.power, lamps.inner, lamps.outer, lamps.reach
        clear.left = wp.full(2, wp.vec3(1.0, 1.0, 1.0), dtype=wp.vec3, device=device)
        clear.left_step = 1.0
        clear.beams = wp.zeros(lamps.beams.shape, dtype=wp.vec3, device=device)
    return clear


def place_lamps(lamps: Lamps, recipes: Sequence[LampRecipe], T_map_base: Array, device: str) -> None:
    """Place the lamps for a vehicle at T_map_base (4, 4)."""
    positions = np.array([_turn(T_map_base, lamp.position_m) + T_map_base[:3, 3] for lamp in recipes])
    mounts = [Rotation.from_euler("ZY", [lamp.yaw_deg, lamp.pitch_deg], degrees=True).as_matrix() for lamp in recipes]
    axes = np.array([_turn(T_map_base, mount[:, 0]) for mount in mounts])
    lamps.positions = wp.array(np.round(positions, 7).astype(np.float32), dtype=wp.vec3, device=device)
    lamps.axes = wp.array(np.round(axes, 7).astype(np.float32), dtype=wp.vec3, device=device)


def _turn(T: Array, vector: Sequence[float] | Array) -> Array:
    """Rotate a vector (3,) by a pose, written out so that sums have the same order on every processor."""
    return np.asarray(T[:3, 0] * vector[0] + T[:3, 1] * vector[1] + T[:3, 2] * vector[2])


@wp.func
def arc_tangent(x: float):
    """Arc tangent by Abramowitz & Stegun (1964), 4.4.49: within 2e-8 for |x| <= 1, and by the complement beyond."""
    a = wp.abs(x)
    inside = a
    if a > 1.0:
        inside = 1.0 / a
    y = inside * inside
    s = -0.0161657367 + y * 0.0028662257
    s = 0.0429096138 + y * s
    s = -0.0752896400 + y * s
    s = 0.1065626393 + y * s
    s = -0.1420889944 + y * s
    s = 0.1999355085 + y * s
    s = -0.3333314528 + y * s
    angle = inside * (1.0 + y * s)
    if a > 1.0:
        angle = HALF_PI - angle
    if x < 0.0:
        angle = -angle
    return angle


@wp.func
def phase(cosine: float, g: float):
    """Henyey-Greenstein phase function, 1/sr, at the cosine of the scattering angle."""
    base = 1.0 + g * g - 2.0 * g * cosine
    return (1.0 - g * g) / (4.0 * PI * base * wp.sqrt(base))


@wp.kernel
def sum_beams(view: CameraView, optics: Optics, scattering: wp.vec3, g: float, beams: wp.array3d(dtype=wp.vec3)):
    """Sum the lamp light scattered into each ray of the grid up to each range node."""
    row, column = wp.tid()
    lamps = optics.lamps
    field = optics.turbidity
    height = float(view.rays.shape[0] - 3)
    width = float(view.rays.shape[1] - 3)
    v = height * float(row) / float(beams.shape[0] - 1)
    u = width * float(column) / float(beams.shape[1] - 1)
    origin = ray_start(view, u, v)
    direction = wp.normalize(ray_through(view, u, v))
    nodes = beams.shape[2]
    total = wp.vec3(0.0, 0.0, 0.0)
    beams[row, column, 0] = total
    start = wp.float32(0.0)
    before = wp.vec2(0.0, 0.0)
    for k in range(1, nodes):
        share = float(k) / float(nodes - 1)
        end = lamps.reach * share * share
        middle = 0.5 * (start + end)
        p = origin + direction * middle
        back = look_up(lamps.left, middle / lamps.left_step)
        thick = scattering
        if field.on != 0:
            y = float(row) / float(beams.shape[0] - 1)
            x = float(column) / float(beams.shape[1] - 1)
            rows = float(field.along.shape[0] - 1)
            columns = float(field.along.shape[1] - 1)
            here = interpolate(field.along, y * rows, x * columns, node_at(field.along.shape[2], field.reach, end))
            amount = (before + here) * 0.5
            lost = decays(field.own_spread * amount[0] + field.silt_spread * amount[1])
            z = node_at(field.along.shape[2], field.reach, middle) * float(field.lit.shape[2] - 1)
            z = z / float(field.along.shape[2] - 1)
            lit = interpolate(field.lit, y * float(field.lit.shape[0] - 1), x * float(field.lit.shape[1] - 1), z)
            lost = wp.cw_mul(lost, decays(field.own_spread * lit[0] + field.silt_spread * lit[1])) * lit[2]
            back = wp.cw_mul(back, lost)
            piece = (here - before) / (end - start)
            thick = scattering + field.own_scattering * piece[0] + field.silt_scattering * piece[1]
            before = here
        for lamp in range(lamps.count):
            to_lamp = lamps.positions[lamp] - origin
            nearest = wp.dot(to_lamp, direction)
            off = to_lamp - direction * nearest
            apart = wp.max(wp.length(off), LEAST_DISTANCE_M)
            spread = (arc_tangent((end - nearest) / apart) - arc_tangent((start - nearest) / apart)) / apart
            away = p - lamps.positions[lamp]
            distance = wp.max(wp.length(away), LEAST_DISTANCE_M)
            s = wp.dot(away, lamps.axes[lamp]) / distance
            s = wp.clamp((s - lamps.outer[lamp]) / (lamps.inner[lamp] - lamps.outer[lamp]), 0.0, 1.0)
            if s > 0.0:
                light = wp.cw_mul(lamps.power[lamp], look_up(lamps.left, distance / lamps.left_step))
                turned = -wp.dot(away, direction) / distance
                spread_light = spread * s * s * (3.0 - 2.0 * s) * PI * phase(turned, g)
                total += wp.cw_mul(wp.cw_mul(light, back), thick) * spread_light
        beams[row, column, k] = total
        start = end
