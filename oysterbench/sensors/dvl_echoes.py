"""Bottom echoes in the beams of a DVL: their range, whether they are strong enough, and whether plants are met."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.recipe import CLASSES, SiteRecipe
from oysterbench.sensors import acoustics

if TYPE_CHECKING:
    from oysterbench.render.rays import RayCaster
    from oysterbench.sensors.dvl import DvlRecipe

FREQUENCY_KHZ = 1000.0  # of a DVL of the A50's class
CONE_RAYS, CONE_DEG = 6, 1.5  # rays around each beam's axis, and their angle off it: a beam is some 4 deg wide
GRAZING_COSINE = 0.25  # cosine of incidence below which an echo is too long to measure
WEAKEST_BOTTOM = "mud"  # weakest bottom on which it keeps its lock at max_range_m
MARGIN = 1.2  # factor by which rays reach farther, in case the assumed speed of sound makes ranges shorter
PLANT = next(number for number, name in CLASSES.items() if name == "plant")


def listen(
    caster: RayCaster,
    recipe: DvlRecipe,
    site: SiteRecipe,
    bottom: str,
    origins: Array,
    rotations: Array,
    beams: Array,
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """True ranges (N, 4) m of the beams (4, 3) in base_link, whether their echoes can be measured (N, 4), and whether
    any ray of a ping meets a plant (N,).

    Ranges are means over a beam's rays, weighted by echo strength. An echo is lost where the beam grazes the surface,
    and where it is weaker than that of mud at max_range_m, at the incidence of a level bottom.
    """
    rays = np.concatenate([cone(beam) for beam in beams])
    directions = np.einsum("nij,rj->nri", rotations, rays)
    starts = np.repeat(origins, len(rays), axis=0)
    echoes = caster.cast(starts, directions.reshape(-1, 3), MARGIN * recipe.max_range_m)
    cosines = np.abs(np.einsum("ni,ni->n", echoes.normals.astype(float), directions.reshape(-1, 3)))
    loss = acoustics.absorption(site, -float(origins[:, 2].mean()), FREQUENCY_KHZ)
    mu = acoustics.backscatter(bottom)[echoes.classes]
    steep = np.where(cosines >= GRAZING_COSINE, mu, 0.0)
    shape = (len(origins), 4, CONE_RAYS + 1)
    seen = echoes.ranges.astype(float).reshape(shape)
    strengths = acoustics.echo_strength(seen, cosines.reshape(shape), steep.reshape(shape), loss)
    total = strengths.sum(axis=2)
    ranges = (strengths * np.where(np.isfinite(seen), seen, 0.0)).sum(axis=2) / np.where(total > 0, total, 1.0)
    weakest = acoustics.backscatter(WEAKEST_BOTTOM)[1]
    slant = np.cos(np.radians(recipe.janus_deg + CONE_DEG))
    threshold = acoustics.echo_strength(np.array(recipe.max_range_m), slant, weakest, loss)
    plants = (echoes.classes == PLANT).reshape(len(origins), -1).any(axis=1)
    return ranges, total / (CONE_RAYS + 1) >= threshold, plants


def cone(axis: Array) -> Array:
    """Unit vectors (CONE_RAYS + 1, 3): the axis (3,) of a beam, and CONE_RAYS rays around it."""
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    around = 2 * np.pi * np.arange(CONE_RAYS)[:, None] / CONE_RAYS
    off = np.radians(CONE_DEG)
    ring = np.cos(off) * axis + np.sin(off) * (np.cos(around) * side + np.sin(around) * other)
    return np.concatenate([axis[None], ring])
