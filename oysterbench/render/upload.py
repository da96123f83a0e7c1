"""Upload of a world, its appearance and its optics to a device."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy import ndimage

from oysterbench.recipe import SequenceRecipe
from oysterbench.render import kernels
from oysterbench.render.casting import Geometry, Placed, Vehicle
from oysterbench.render.ground import build_ground
from oysterbench.render.light import Light, shadow_reach
from oysterbench.render.looks import Looks
from oysterbench.render.movers import Meshes, Movers
from oysterbench.render.noise import key_of
from oysterbench.render.optics import Optics
from oysterbench.render.relief import build_relief
from oysterbench.render.tree import upload_library, upload_tree
from oysterbench.render.water import Water
from oysterbench.scene.clutter import GRASS_M
from oysterbench.scene.life import Life
from oysterbench.scene.life.sway import REACH
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.world import World

CREVICE_BLUR_CELLS = 2.0
CREVICE_RISE_M = 0.02
LEAF_TRIANGLES = 4  # per leaf of Warp's trees: fastest in measurements
VEHICLE_MARGIN_M = 1e-3  # of the box around it
LEAST_SUN = 1e-6
SWAY_M = REACH * GRASS_M[1]  # largest displacement of swaying tips
CLEAR_BOUNCE = 0.16  # albedo of the bottom as seen by a downward-facing surface


def upload_geometry(world: World, device: str, life: Life | None = None) -> tuple[Geometry, Movers | None, list[Any]]:
    """Upload a world's arrays, meshes and tree of boxes; return them, the moving things (None without life), and the
    objects that must be kept alive as long as these are used."""
    instances = world.instances
    terrain = world.terrain
    shapes = (*world.meshes, *(() if life is None else life.meshes))
    start, step = terrain.coordinates[terrain.rim], np.diff(terrain.coordinates)[terrain.rim]
    skirt = terrain.skirt()
    skirt_mesh = _mesh(skirt.vertices, skirt.faces, device)
    library, roots = upload_library(shapes, device)
    vertex_counts = [len(mesh.vertices) for mesh in shapes]
    first_vertex = np.cumsum([0, *vertex_counts[:-1]])
    corners = [m.faces.ravel() + start for m, start in zip(shapes, first_vertex, strict=True)]
    meshes = Meshes(roots, [mesh.faces.size for mesh in shapes])
    geometry = Geometry()
    geometry.library = library
    geometry.relief = build_relief(terrain.square, float(start), float(step), device)
    geometry.skirt = skirt_mesh.id
    geometry.skirt_corners = skirt_mesh.indices
    geometry.skirt_normals = wp.array(skirt.normals, dtype=wp.vec3, device=device)
    geometry.corners = wp.array(np.concatenate(corners), dtype=wp.int32, device=device)
    points = np.concatenate([mesh.vertices for mesh in shapes])
    geometry.points = wp.array(points, dtype=wp.vec3, device=device)
    normals = np.concatenate([mesh.normals for mesh in shapes])
    geometry.normals = wp.array(normals, dtype=wp.vec3, device=device)
    marks = np.concatenate([mesh.marks for mesh in shapes])
    geometry.marks = wp.array(marks, dtype=wp.vec3, device=device)
    placed = meshes.rows(instances)
    geometry.placed = wp.array(placed, dtype=Placed, device=device)
    kept: list[Any] = [skirt_mesh]
    movers = None if life is None else Movers(geometry, world, life, meshes, placed, device)
    geometry.count = len(instances) if movers is None else movers.first
    if geometry.count:
        lowers, uppers = (corner[: geometry.count] for corner in world.boxes)
        geometry.tree = upload_tree(lowers, uppers, device)
        boxes = wp.Bvh(wp.array(lowers, dtype=wp.vec3, device=device), wp.array(uppers, dtype=wp.vec3, device=device))
        geometry.boxes = boxes.id
        kept.append(boxes)
    return geometry, movers, kept


def upload_vehicle(mesh: Mesh | None, number: int, device: str) -> tuple[Vehicle, list[Any]]:
    """Upload a rig's body, not yet placed; return it (mesh 0 for none) and the objects that must be kept alive with it.
    number: id in instance images."""
    vehicle = Vehicle()
    if mesh is None:
        return vehicle, []
    body = _mesh(mesh.vertices, mesh.faces, device)
    vehicle.mesh = body.id
    vehicle.number = number
    vehicle.corners = body.indices
    vehicle.normals = wp.array(mesh.normals, dtype=wp.vec3, device=device)
    vehicle.marks = wp.array(mesh.marks, dtype=wp.vec3, device=device)
    vehicle.low = wp.vec3(*(mesh.vertices.min(axis=0) - VEHICLE_MARGIN_M).tolist())
    vehicle.high = wp.vec3(*(mesh.vertices.max(axis=0) + VEHICLE_MARGIN_M).tolist())
    vehicle.radius = float(np.sqrt((mesh.vertices.astype(float) ** 2).sum(axis=1).max())) + 1e-3
    return vehicle, [body]


def upload_looks(world: World, recipe: SequenceRecipe, fan: NDArray[np.float32], device: str) -> Looks:
    """Appearance of surfaces, and where on the reef to test for shadows and occluded sky.

    fan (N, 3): unit vectors towards all light that casts shadows.
    """
    looks = Looks()
    looks.seed = key_of(world.appearance.seed, world.appearance, "looks")
    looks.ground = build_ground(recipe.reef)
    looks.envelope_start = float(world.envelope_lines[0])
    cell = float(world.envelope_lines[1] - world.envelope_lines[0])
    looks.envelope_step = cell
    ground = world.ground_height(*np.meshgrid(world.envelope_lines, world.envelope_lines))
    things = world.envelope > ground + 1e-3
    raised = world.envelope + CREVICE_RISE_M * things
    blurred = ndimage.gaussian_filter(raised, CREVICE_BLUR_CELLS)
    looks.envelope = wp.array(np.round(blurred, 6).astype(np.float32), dtype=wp.float32, device=device)
    reach = shadow_reach(world.envelope, ground, cell, fan, float(kernels.SHADOW_M))
    swaying = 2 * int(np.ceil(SWAY_M / cell)) + 1 if recipe.life.sway else 1
    reach = ndimage.maximum_filter(reach, size=swaying)
    looks.reach = wp.array(reach.astype(np.uint8), dtype=wp.uint8, device=device)
    if recipe.light.occlusion_m > 0:
        cells = int(np.ceil(recipe.light.occlusion_m / cell)) + 1
        near = ndimage.maximum_filter(things, size=2 * cells + swaying)
        looks.near = wp.array(near.astype(np.uint8), dtype=wp.uint8, device=device)
    return looks


def upload_optics(
    water: Water, light: Light, fan: NDArray[np.float32], recipe: SequenceRecipe, steepest: float, device: str
) -> Optics:
    """Upload tables of water and daylight, without lamps and caustics.

    fan (16, 3): as from light.sun_fan; steepest: largest slope of the seabed (rise over run).
    """

    def table(values: NDArray[np.float64]) -> wp.array:
        return wp.array(values.astype(np.float32), dtype=wp.vec3, device=device)

    daylight = recipe.light.daylight
    optics = Optics()
    optics.sun_direction = wp.vec3(*light.sun_direction.tolist())
    optics.fan = wp.array(fan, dtype=wp.vec3, device=device)
    # In the clearest water the fan is so narrow that rounding alone may bring 1 - cos^2 below 0.
    square = float(np.mean(1.0 - (fan @ light.sun_direction) ** 2))
    optics.spread = round(float(np.sqrt(max(square, 0.0))), 6)
    optics.sun, optics.sky, optics.bounce = light.sun * daylight, light.sky * daylight, CLEAR_BOUNCE * daylight
    optics.occlusion = recipe.light.occlusion_m
    optics.shade, optics.shade_m = recipe.light.shade, recipe.light.shade_m
    optics.seabed_shadows = int(steepest > light.steepest_lit_slope())
    optics.direct, optics.forward_scatter = table(water.direct), table(water.forward_scatter)
    optics.saturation = table(water.saturation)
    optics.veil = table(water.veil * daylight)
    optics.stretch = table(water.stretch)
    optics.range_step = float(water.ranges[1])
    optics.daylight, optics.beam = table(water.daylight), table(water.beam / max(light.sun, LEAST_SUN))
    optics.depth_step = float(water.depths[1])
    optics.cosine_step = float(water.cosines[1] - water.cosines[0])
    return optics


def without_water(optics: Optics, device: str) -> Optics:
    """Return the same light without water: all of it arrives, and nothing is added on the way."""
    clear = Optics()
    for name in (
        "sun_direction",
        "fan",
        "spread",
        "sun",
        "sky",
        "bounce",
        "occlusion",
        "shade",
        "shade_m",
        "shade_seed",
        "seabed_shadows",
        "caustics",
        "lamps",
    ):
        setattr(clear, name, getattr(optics, name))
    towards = wp.vec3(*clear.sun_direction)
    clear.fan, clear.spread = wp.full(16, towards, dtype=wp.vec3, device=device), 0.0
    ones, zeros = (wp.full((2, 2), wp.vec3(v, v, v), dtype=wp.vec3, device=device) for v in (1.0, 0.0))
    clear.direct, clear.stretch = ones, ones
    clear.forward_scatter, clear.saturation, clear.veil = zeros, zeros, zeros
    clear.daylight, clear.beam = (wp.full(2, wp.vec3(1.0, 1.0, 1.0), dtype=wp.vec3, device=device) for _ in range(2))
    clear.range_step = clear.depth_step = clear.cosine_step = 1.0
    return clear


def _mesh(vertices: NDArray[np.float32], faces: NDArray[np.int32], device: str) -> wp.Mesh:
    points = wp.array(vertices, dtype=wp.vec3, device=device)
    return wp.Mesh(points, wp.array(faces.ravel(), dtype=wp.int32, device=device), bvh_leaf_size=LEAF_TRIANGLES)
