"""A camera in a world: colour, depth along the axis, classes and instances, and the layers that make up the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.recipe import CameraRecipe, RigRecipe, SequenceRecipe
from oysterbench.render import (
    blur,
    caustics,
    defocus,
    develop,
    edges,
    flow,
    kernels,
    lamps,
    march,
    occlusion,
    port,
    rays,
    sensor,
    shutter,
    snow,
    visibility,
)
from oysterbench.render.light import exposure
from oysterbench.render.passage import STILL, Moment, Passage
from oysterbench.render.target import start_warp
from oysterbench.render.tracing import Pose, ViewTracer
from oysterbench.render.view import CameraView
from oysterbench.scene.life import Life, moving_classes
from oysterbench.scene.plumes import Plumes
from oysterbench.scene.rig import camera_pose
from oysterbench.scene.world import World

MODULES = (
    kernels,
    edges,
    occlusion,
    sensor,
    lamps,
    caustics,
    snow,
    blur,
    visibility,
    rays,
    shutter,
    defocus,
    port,
    march,
    flow,
    develop,
)
LAYERS = (
    "radiance",
    "clean",
    "direct",
    "forward_scatter",
    "backscatter",
    "snow",
    "depth",
    "normals",
    "classes",
    "instances",
    "visibility",
    "dynamic",
    "flow",
    "transmittance",
)
UNLIT = ("depth", "normals", "classes", "instances", "visibility", "dynamic", "flow")
"""Layers that need no light: without any others, they cost a tenth of a rendered image."""


@dataclass(frozen=True)
class Frame:
    """Image and ground truth of a camera at one pose.

    colour (H, W, 3) uint8 RGB; depth (H, W) float32, m along the optical axis, 0 where nothing is within the camera's
    max_range_m; classes (H, W) uint8 as in recipe.CLASSES; instances (H, W) uint16: 0 for none, the world's last id + 1
    for the vehicle, and from + 2 on for roaming things (scene.life). Depth, classes and instances belong to the ray
    through the pixel's centre.
    """

    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    classes: NDArray[np.uint8]
    instances: NDArray[np.uint16]


def warm_up(device: str = "cpu") -> None:
    """Compile and load the kernels into Warp's cache, where processes started later find them."""
    start_warp()
    for module in MODULES:
        wp.load_module(module, device=device)


class CameraRenderer(ViewTracer):
    """Renders a world for one camera: turns what ViewTracer traces into frames and layers."""

    def __init__(
        self,
        world: World,
        camera: CameraRecipe,
        recipe: SequenceRecipe,
        device: str = "cpu",
        rig: RigRecipe | None = None,
        plumes: Plumes | None = None,
        life: Life | None = None,
    ) -> None:
        super().__init__(world, camera, recipe, device, rig, plumes, life)
        self._count = len(world.instances) + 1 + (0 if life is None else life.count)
        self._moving_classes = moving_classes(recipe)
        metered = exposure(self._water, recipe.reef.depth_m, recipe.light.daylight, self._lamps, recipe.light.lamps)
        scale = (metered * 2.0**camera.exposure_stops).tolist()
        self.exposure = sensor.Exposure(camera.shutter_ms * 1e-3, camera.gain, scale)
        dark = sensor.dark_signal(camera, self._streams) if camera.hot_pixels else np.zeros((1, 1, 3), dtype=np.float32)
        self._dark = wp.array(dark, dtype=wp.vec3, device=device)
        self._vignetting = wp.array(sensor.vignette(self._rays, camera), dtype=wp.float32, device=device)
        self._gamma = wp.array(sensor.gamma_table(), dtype=wp.uint8, device=device)
        self._developer = develop.Developer(camera, device) if develop.processes(camera) else None
        self._colour = wp.zeros((camera.height, camera.width, 3), dtype=wp.uint8, device=device)

    def render(
        self,
        T_map_cam: Pose,
        generator: np.random.Generator,
        time_s: float = 0.0,
        T_map_base: Pose | None = None,
        passage: Passage = STILL,
        exposure: sensor.Exposure | None = None,
    ) -> Frame:
        """Render a frame at the pose T_map_cam (4, 4) of the optical frame in `map`; `generator` draws sensor noise.

        time_s moves waves and marine snow. T_map_base: pose of the vehicle, for cameras not mounted on it as the recipe
        says. passage: the camera's motion during the exposure; moving things are where they are at time_s, in all rows.
        Depth, classes and instances belong to each row's own pose, in the middle of its exposure. exposure: replaces
        the recipe's, as currently metered.
        """
        exposure = exposure or self.exposure
        self._prepare(T_map_cam, time_s, T_map_base)
        radiance = self._expose(T_map_cam, time_s, passage)
        with self._timed("noise"):
            shape = (self.camera.height, self.camera.width, 3)
            noise = wp.array(generator.standard_normal(shape, dtype=np.float32), device=self.device)
        with self._timed("apply_sensor_model"):
            gain = exposure.gain
            dark_s = gain * (exposure.shutter_s or sensor.INSTANT_S) if self.camera.hot_pixels else 0.0
            wp.launch(
                sensor.apply_sensor_model,
                shape[:2],
                inputs=[
                    radiance,
                    self._vignetting,
                    noise,
                    self._dark,
                    dark_s,
                    wp.vec3(*exposure.scale),
                    gain / sensor.FULL_WELL,
                    gain * sensor.READ_NOISE,
                    self._gamma,
                ],
                outputs=[self._colour],
                device=self.device,
            )
        if self._developer is not None:
            with self._timed("develop"):
                self._developer.develop(self._colour)
        return Frame(*(array.numpy().copy() for array in (self._colour, *self._truth)))

    def truth(
        self, T_map_cam: Pose, time_s: float = 0.0
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.uint16]]:
        """Depth, classes and instances at a pose, as in Frame, without the light: a tenth of the time of an image."""
        self._place(np.asarray(T_map_cam, dtype=float) @ np.linalg.inv(camera_pose(self.camera)), time_s)
        self._cast(self._view(T_map_cam))
        depth, classes, instances = (array.numpy().copy() for array in self._truth)
        return depth, classes, instances

    def layers(
        self,
        T_map_cam: Pose,
        names: Sequence[str],
        time_s: float = 0.0,
        T_map_base: Pose | None = None,
        passage: Passage = STILL,
        following: Moment | None = None,
    ) -> dict[str, NDArray[np.generic]]:
        """Layers of the image at a pose, by their names in LAYERS, before lens shading, exposure and noise.

        Radiances (H, W, 3) float32, where 1 is that of a white matte surface in full daylight at the surface: `direct`,
        `forward_scatter`, `backscatter` (of daylight and lamps) and `snow` (the change made by flakes) add up to
        `radiance`; `clean` is the same light in the same place without any water. depth, classes, instances: as in
        Frame. dynamic (H, W) uint8: 1 where something moves by itself, including the vehicle, and 0 elsewhere; shadows
        do not count. flow (H, W, 2) float32: displacement in px, to the right and down, of the point seen in a pixel
        until the moment `following`; NaN where there is nothing, and for points that are then behind the camera.
        normals (H, W, 3) float32: outward unit normals in the optical frame, 0 where there is nothing. visibility (N,)
        float32 by instance number: pixels in which it is seen over those in which it would be seen on its own; NaN if
        there are none. transmittance (H, W) float32: share, in green, of a surface's daylight that arrives, sharp or
        blurred; 0 where there is nothing. passage: as for `render`; layers show a single instant in each row.

        Raises ValueError for unknown names, and for `flow` without `following`.
        """
        unknown = sorted(set(names) - set(LAYERS))
        if unknown:
            raise ValueError(f"unknown layers {unknown}; expected some of {', '.join(LAYERS)}")
        view = self._view(T_map_cam, passage)
        self._prepare(T_map_cam, time_s, T_map_base)
        found: dict[str, NDArray[np.generic]] = {}
        if set(names) <= set(UNLIT):
            self._cast(view)
        else:
            found |= self._light_layers(T_map_cam, time_s, passage)
        depth, classes, instances = (array.numpy().copy() for array in self._truth)
        found |= {"depth": depth, "classes": classes, "instances": instances}
        if "normals" in names:
            turns = T_map_cam[None, :3, :3] if passage.rows is None else passage.rows[1:-1, :3, :3]
            turned = self._normals.numpy() @ np.asarray(turns, dtype=np.float32)
            found["normals"] = np.where(depth[..., None] > 0, turned, np.float32(0.0))
        if "dynamic" in names:
            found["dynamic"] = np.isin(classes, self._moving_classes).astype(np.uint8)
        if "flow" in names:
            if following is None:
                raise ValueError("layer flow: expected the moment of the next frame in `following`, got None")
            base = np.round(np.asarray(following.T_map_base, dtype=float), 9)
            points = flow.carried(self._geometry, self._movers, view, self._hits, following.time_s, base)
            found["flow"] = flow.project_motion(points.numpy(), depth > 0, following, self.camera)
        if "transmittance" in names:
            arriving = wp.zeros(depth.shape, dtype=wp.float32, device=self.device)
            inputs = [view, self._optics, self._hits]
            wp.launch(visibility.transmit, depth.shape, inputs=inputs, outputs=[arriving], device=self.device)
            found["transmittance"] = arriving.numpy()
        if "visibility" in names:
            found["visibility"] = self._visibility(view, instances)
        if "clean" in names:
            self._trace(view, self._clear)
            found["clean"] = self._sharp.numpy().copy()
        return {name: found[name] for name in names}

    def _light_layers(self, T_map_cam: Pose, time_s: float, passage: Passage) -> dict[str, NDArray[np.generic]]:
        """Layers of the light that arrives in each pixel: radiance and its parts."""
        radiance = self._expose(T_map_cam, time_s, Passage(passage.rows), ideal=True).numpy().copy()
        share = self._blur_share
        direct, forward_scatter, backscatter = (
            array.numpy().copy() for array in (self._sharp, self._forward_scatter, self._backscatter)
        )
        if self._optics.turbidity.silty:
            forward_scatter = forward_scatter + self._blurred.numpy()
        elif share > 0:
            forward_scatter = forward_scatter * np.float32(1 - share) + self._blurred.numpy() * np.float32(share)
        return {
            "radiance": radiance,
            "direct": direct,
            "forward_scatter": forward_scatter,
            "backscatter": backscatter,
            "snow": radiance - (direct + forward_scatter + backscatter),
        }

    def _visibility(self, view: CameraView, instances: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Visible pixels over unoccluded pixels (N,) by instance number, NaN where there are none."""
        counts = wp.zeros(self._count + 1, dtype=wp.int32, device=self.device)
        inputs = [self._geometry, view]
        wp.launch(visibility.count_unhidden, instances.shape, inputs=inputs, outputs=[counts], device=self.device)
        alone = counts.numpy()
        seen = np.bincount(instances.ravel(), minlength=len(alone))
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(alone > 0, np.minimum(seen / alone, 1.0), np.nan)
        share[0] = np.nan
        return share.astype(np.float32)
