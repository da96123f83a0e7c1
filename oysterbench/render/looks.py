"""Appearance of surfaces, and what the heights of objects on the bottom say about the light there."""

from __future__ import annotations

import warp as wp

from oysterbench.render.ground import Ground
from oysterbench.render.optics import Optics

CREVICE_M = wp.constant(0.04)
"""Depth below the envelope at which half of the sky is visible, as rays in dense beds find at depths of 0 to 0.1 m."""


@wp.struct
class Looks:
    """Appearance of surfaces. envelope: blurred upper surface of everything, for the darkness of crevices; raised by
    CREVICE_RISE_M (upload.py) where things stand, as they hide each other's sky even at that height. reach, near: where
    on the same grid things may shade the seabed, and where they may hide sky from it.
    """

    seed: wp.vec2ui
    ground: Ground
    envelope: wp.array2d(dtype=wp.float32)
    reach: wp.array2d(dtype=wp.uint8)
    near: wp.array2d(dtype=wp.uint8)
    envelope_start: wp.float32
    envelope_step: wp.float32


@wp.func
def openness(looks: Looks, p: wp.vec3):
    """Share of the sky that a point sees, from its depth below the blurred envelope: 1 in the open."""
    x = (p[0] - looks.envelope_start) / looks.envelope_step
    y = (p[1] - looks.envelope_start) / looks.envelope_step
    last = float(looks.envelope.shape[0] - 2)
    share = wp.float32(1.0)
    if x > 0.0 and y > 0.0 and x < last and y < last:
        j = int(x)
        i = int(y)
        u = x - float(j)
        v = y - float(i)
        low = looks.envelope[i, j] * (1.0 - u) + looks.envelope[i, j + 1] * u
        high = looks.envelope[i + 1, j] * (1.0 - u) + looks.envelope[i + 1, j + 1] * u
        below = (low * (1.0 - v) + high * v - p[2]) / CREVICE_M
        share = 1.0 / (1.0 + wp.max(below, 0.0))
    return share


@wp.func
def needs_shadow_ray(looks: Looks, optics: Optics, instance: int, p: wp.vec3):
    """False only if nothing can be between a point of the seabed and the sun."""
    j = int(wp.floor((p[0] - looks.envelope_start) / looks.envelope_step + 0.5))
    i = int(wp.floor((p[1] - looks.envelope_start) / looks.envelope_step + 0.5))
    last = looks.reach.shape[0] - 1
    needed = instance >= 0 or optics.seabed_shadows != 0 or i < 0 or j < 0 or i > last or j > last
    if not needed:
        needed = looks.reach[i, j] != wp.uint8(0)
    return needed


@wp.func
def crowded(looks: Looks, p: wp.vec3):
    """False only if nothing near a point of the seabed can hide sky from it."""
    j = int(wp.floor((p[0] - looks.envelope_start) / looks.envelope_step + 0.5))
    i = int(wp.floor((p[1] - looks.envelope_start) / looks.envelope_step + 0.5))
    last = looks.near.shape[0] - 1
    near = wp.bool(True)
    if i >= 0 and j >= 0 and i <= last and j <= last:
        near = looks.near[i, j] != wp.uint8(0)
    return near
