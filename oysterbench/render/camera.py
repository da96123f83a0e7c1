"""A pinhole camera in a world: colour, depth along the axis, classes and instances."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy import ndimage

from oysterbench.recipe import CameraRecipe, SequenceRecipe
from oysterbench.render import kernels
from oysterbench.render.casting import Geometry, Placed
from oysterbench.render.light import build_light, exposure, shadow_reach
from oysterbench.render.radiance import Daylight
from oysterbench.render.relief import build_relief
from oysterbench.render.texture import build_ground
from oysterbench.render.water import build_water
from oysterbench.scene.rig import camera_matrix
from oysterbench.scene.world import World

DEPTH_MARGIN_M = 3.0  # of the water's tables below the mean bottom
CREVICE_BLUR_CELLS = 2.0
SHOT_NOISE = 1.0 / 6000.0  # variance per signal: a full well of 6000 electrons
READ_NOISE = 0.0015  # of full scale
GAMMA_LEVELS = 8192
LEAF_TRIANGLES = 4  # of the meshes' trees: measured best


@dataclass(frozen=True)
class Frame:
    """What a camera sees at one pose.

    colour (H, W, 3) uint8 RGB; depth (H, W) float32, m along the optical axis, 0 where nothing is within the camera's
    max_range_m; classes (H, W) uint8 as in recipe.CLASSES; instances (H, W) uint16, 0 for none. Depth, classes and
    instances are those of the ray through the pixel's centre.
    """

    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    classes: NDArray[np.uint8]
    instances: NDArray[np.uint16]


def warm_up(device: str = "cpu") -> None:
    """Compile and load the kernels, into Warp's cache, so that processes started later find them there."""
    _start_warp()
    wp.load_module(kernels, device=device)


class CameraRenderer:
    """Renders a world for one camera; the world goes to the device once."""

    def __init__(self, world: World, camera: CameraRecipe, recipe: SequenceRecipe, device: str = "cpu") -> None:
        _start_warp()
        self.camera = camera
        self.device = device
        self._upload(world)
        self._light(world, recipe)
        shape = (camera.height, camera.width)
        self._radiance = wp.zeros(shape, dtype=wp.vec3, device=device)
        self._smooth = wp.zeros(shape, dtype=wp.vec3, device=device)
        self._depth = wp.zeros(shape, dtype=wp.float32, device=device)
        self._classes = wp.zeros(shape, dtype=wp.uint8, device=device)
        self._instances = wp.zeros(shape, dtype=wp.uint16, device=device)
        self._colour = wp.zeros((*shape, 3), dtype=wp.uint8, device=device)

    def render(self, T_map_cam: NDArray[np.float64], generator: np.random.Generator) -> Frame:
        """Frame from the pose T_map_cam (4, 4) of the optical frame in `map`; `generator` gives the sensor's noise."""
        view = kernels.View()
        matrix = camera_matrix(self.camera)
        pose = np.asarray(T_map_cam, dtype=np.float32)
        view.position = wp.vec3(*pose[:3, 3].tolist())
        view.rotation = wp.mat33(*pose[:3, :3].ravel().tolist())
        view.focal, view.cx, view.cy = float(matrix[0, 0]), float(matrix[0, 2]), float(matrix[1, 2])
        view.max_range = self.camera.max_range_m
        shape = (self.camera.height, self.camera.width)
        scene = [self._geometry, self._looks, self._optics, view]
        truth = [self._depth, self._classes, self._instances]
        wp.launch(kernels.trace, shape, inputs=scene, outputs=[self._radiance, *truth], device=self.device)
        wp.launch(
            kernels.refine,
            shape,
            inputs=[*scene, self._radiance, self._instances],
            outputs=[self._smooth],
            device=self.device,
        )
        noise = wp.array(generator.standard_normal((*shape, 3), dtype=np.float32), device=self.device)
        wp.launch(
            kernels.develop,
            shape,
            inputs=[self._smooth, noise, self._gain, SHOT_NOISE, READ_NOISE, self._gamma],
            outputs=[self._colour],
            device=self.device,
        )
        return Frame(*(array.numpy().copy() for array in (self._colour, *truth)))

    def _upload(self, world: World) -> None:
        """The world's arrays, meshes and tree of boxes on the device."""
        device = self.device
        instances = world.instances
        terrain = world.terrain
        start, step = terrain.coordinates[terrain.rim], np.diff(terrain.coordinates)[terrain.rim]
        skirt = terrain.skirt()
        self._skirt = _mesh(skirt.vertices, skirt.faces, device)
        self._library = [_mesh(mesh.vertices, mesh.faces, device) for mesh in world.meshes]
        corner_counts = [mesh.faces.size for mesh in world.meshes]
        vertex_counts = [len(mesh.vertices) for mesh in world.meshes]
        first_corner = np.cumsum([0, *corner_counts[:-1]])
        first_vertex = np.cumsum([0, *vertex_counts[:-1]])
        corners = [m.faces.ravel() + start for m, start in zip(world.meshes, first_vertex, strict=True)]
        ids = np.array([mesh.id for mesh in self._library], dtype=np.uint64)
        geometry = Geometry()
        geometry.relief = build_relief(terrain.square, float(start), float(step), device)
        geometry.skirt = self._skirt.id
        geometry.skirt_corners = self._skirt.indices
        geometry.skirt_normals = wp.array(skirt.normals, dtype=wp.vec3, device=device)
        geometry.count = len(instances)
        geometry.corners = wp.array(np.concatenate(corners), dtype=wp.int32, device=device)
        normals = np.concatenate([mesh.normals for mesh in world.meshes])
        geometry.normals = wp.array(normals, dtype=wp.vec3, device=device)
        marks = np.concatenate([mesh.marks for mesh in world.meshes])
        geometry.marks = wp.array(marks, dtype=wp.vec3, device=device)
        placed: NDArray[Any] = np.zeros(len(instances), dtype=Placed.numpy_dtype())  # type: ignore[attr-defined]
        placed["to_shape"] = np.swapaxes(instances.rotations, 1, 2).astype(float) / instances.scales[:, :, None]
        placed["position"] = instances.positions
        placed["mesh"] = ids[instances.shapes]
        placed["rotation"] = instances.rotations
        placed["scale"] = instances.scales
        placed["first_corner"] = first_corner[instances.shapes]
        placed["colour"] = instances.colours
        placed["silt"] = instances.silt
        placed["kind"] = instances.classes
        geometry.placed = wp.array(placed, dtype=Placed, device=device)
        if len(instances):
            lowers, uppers = world.boxes()
            self._boxes = wp.Bvh(
                wp.array(lowers, dtype=wp.vec3, device=device), wp.array(uppers, dtype=wp.vec3, device=device)
            )
            geometry.boxes = self._boxes.id
        self._geometry = geometry

        looks = kernels.Looks()
        looks.seed = world.texture_seed
        blurred = ndimage.gaussian_filter(world.envelope, CREVICE_BLUR_CELLS)
        looks.envelope = wp.array(blurred, dtype=wp.float32, device=device)
        looks.envelope_start = float(world.envelope_lines[0])
        looks.envelope_step = float(world.envelope_lines[1] - world.envelope_lines[0])
        self._looks = looks

    def _light(self, world: World, recipe: SequenceRecipe) -> None:
        """Tables of water and light, and the camera's fixed exposure."""
        light = build_light(recipe.light)
        daylight = Daylight(float(light.sun_direction[2]), light.sky)
        water = build_water(recipe.water, daylight, recipe.reef.depth_m + DEPTH_MARGIN_M)
        optics = kernels.Optics()
        optics.sun_direction = wp.vec3(*light.sun_direction.tolist())
        lines = world.envelope_lines
        ground = world.ground_height(*np.meshgrid(lines, lines))
        cell = self._looks.envelope_step
        reach = shadow_reach(world.envelope, ground, cell, light.sun_direction, float(kernels.SHADOW_M))
        self._looks.ground = build_ground(recipe.reef)
        self._looks.reach = wp.array(reach.astype(np.uint8), dtype=wp.uint8, device=self.device)
        optics.sun, optics.sky = light.sun, light.sky
        optics.seabed_shadows = int(world.terrain.steepest() > light.steepest_lit_slope())
        optics.direct = self._table(water.direct)
        optics.glow = self._table(water.glow)
        optics.saturation = self._table(water.saturation)
        optics.veil = self._table(water.veil)
        optics.stretch = self._table(water.stretch)
        optics.range_step = float(water.ranges[1])
        optics.daylight = self._table(water.daylight)
        optics.depth_step = float(water.depths[1])
        optics.cosine_step = float(water.cosines[1] - water.cosines[0])
        self._optics = optics
        self._gain = wp.vec3(*exposure(water, recipe.reef.depth_m).tolist())
        self._gamma = wp.array(_gamma_table(), dtype=wp.uint8, device=self.device)

    def _table(self, values: NDArray[np.float64]) -> wp.array:
        return wp.array(values.astype(np.float32), dtype=wp.vec3, device=self.device)


def _start_warp() -> None:
    """Start Warp without its greeting, and without its native warning where there is no CUDA driver."""
    wp.config.log_level = wp.LOG_ERROR
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _mesh(vertices: NDArray[np.float32], faces: NDArray[np.int32], device: str) -> wp.Mesh:
    points = wp.array(vertices, dtype=wp.vec3, device=device)
    return wp.Mesh(points, wp.array(faces.ravel(), dtype=wp.int32, device=device), bvh_leaf_size=LEAF_TRIANGLES)


def _gamma_table() -> NDArray[np.uint8]:
    """sRGB code (GAMMA_LEVELS,) of equally spaced linear levels (IEC 61966-2-1)."""
    linear = np.linspace(0.0, 1.0, GAMMA_LEVELS)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)
