"""A camera in a world: colour, depth along the axis, classes and instances, and what the picture is made of."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe, RigRecipe, SequenceRecipe
from oysterbench.render import (
    blur,
    caustics,
    defocus,
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
from oysterbench.render.casting import Hit
from oysterbench.render.lens import pixel_rays
from oysterbench.render.light import build_light, exposure, sky_fan, sun_fan
from oysterbench.render.optics import Optics
from oysterbench.render.passage import STILL, Moment, Passage
from oysterbench.render.radiance import Daylight
from oysterbench.render.target import start_warp
from oysterbench.render.upload import upload_geometry, upload_looks, upload_optics, upload_vehicle, without_water
from oysterbench.render.view import CameraView
from oysterbench.render.water import build_water
from oysterbench.scene.life import Life, moving_classes
from oysterbench.scene.plumes import Plumes
from oysterbench.scene.rig import camera_matrix, camera_pose
from oysterbench.scene.vehicle import build_vehicle
from oysterbench.scene.world import World

Pose = NDArray[np.float64]

DEPTH_MARGIN_M = 3.0  # of the water's tables below the mean bottom
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


@dataclass(frozen=True)
class Frame:
    """What a camera sees at one pose.

    colour (H, W, 3) uint8 RGB; depth (H, W) float32, m along the optical axis, 0 where nothing is within the camera's
    max_range_m; classes (H, W) uint8 as in recipe.CLASSES; instances (H, W) uint16, 0 for none, one more than the
    world's last for the vehicle, and from two more on what roams (scene.life). Depth, classes and instances are those
    of the ray through the pixel's centre.
    """

    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    classes: NDArray[np.uint8]
    instances: NDArray[np.uint16]


def warm_up(device: str = "cpu") -> None:
    """Compile and load the kernels, into Warp's cache, so that processes started later find them there."""
    start_warp()
    for module in MODULES:
        wp.load_module(module, device=device)


class CameraRenderer:
    """Renders a world for one camera; the world goes to the device once.

    rig: the vehicle that carries the camera, with its lamps and body; without it there are none. life: what moves by
    itself. seconds: processor time that each stage has taken so far.
    """

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
        start_warp()
        self.camera = camera
        self.device = device
        self.seconds: dict[str, float] = defaultdict(float)
        self._rays = pixel_rays(camera)
        self._count = len(world.instances) + 1 + (0 if life is None else life.count)
        self._geometry, self._movers, self._kept = upload_geometry(world, device, life)
        if rig is not None:
            body = build_vehicle(rig, with_tether=not recipe.life.tether)
            self._geometry.vehicle, kept = upload_vehicle(body, len(world.instances) + 1, device)
            self._kept += kept
        self._moving_classes = moving_classes(recipe)
        self._lamps = () if rig is None else rig.lamp
        self.recipe = recipe
        self._light(world, recipe, plumes)
        self._allocate()

    def render(
        self,
        T_map_cam: Pose,
        generator: np.random.Generator,
        time_s: float = 0.0,
        T_map_base: Pose | None = None,
        passage: Passage = STILL,
        exposure: sensor.Exposure | None = None,
    ) -> Frame:
        """Frame from the pose T_map_cam (4, 4) of the optical frame in `map`; `generator` gives the sensor's noise.

        time_s moves waves and marine snow. T_map_base: where the vehicle is, for cameras that it does not carry as the
        recipe says. passage: how the camera moves meanwhile; what moves by itself is where it is at time_s in all
        rows. Depth, classes and instances are those of each row's own pose, in the middle of its exposure. exposure: as
        metered now, instead of the recipe's.
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
            return Frame(*(array.numpy().copy() for array in (self._colour, *self._truth)))

    def truth(
        self, T_map_cam: Pose, time_s: float = 0.0
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.uint16]]:
        """Depth, classes and instances at a pose, as in Frame, without the light: a tenth of a picture's time."""
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
        """What the picture at a pose is made of, each by its name in LAYERS, before lens shading, exposure and noise.

        Radiances (H, W, 3) float32, of which 1 is a white matte surface's in full daylight at the surface: `direct`,
        `forward_scatter`, `backscatter` (of daylight and lamps) and `snow` (what flakes change) add up to `radiance`;
        `clean` is the same light in the same place without any water. depth, classes, instances: as in
        Frame. dynamic (H, W) uint8: 1 where something moves by itself, be it the vehicle, and 0 elsewhere; shadows do
        not count. flow (H, W, 2) float32: px to the right and down that what a pixel shows moves in the picture until
        the moment `following`; NaN where nothing is, and for what is then behind the camera. normals (H, W, 3)
        float32: outward unit normals in the optical frame, 0 where nothing is. visibility (N,) float32 by instance
        number: pixels in which it is seen over those in which it would be if it were alone; NaN for what has none.
        transmittance (H, W) float32: share in green of a surface's daylight that arrives, sharp or blurred; 0 where
        nothing is. passage: as for `render`; layers are those of an instant in each row.
        """
        unknown = sorted(set(names) - set(LAYERS))
        if unknown:
            raise ValueError(f"unknown layers {unknown}; expected some of {', '.join(LAYERS)}")
        view = self._view(T_map_cam, passage)
        self._prepare(T_map_cam, time_s, T_map_base)
        radiance = self._expose(T_map_cam, time_s, Passage(passage.rows), ideal=True).numpy().copy()
        share = self._blur_share
        direct, forward_scatter, backscatter = (
            array.numpy().copy() for array in (self._sharp, self._forward_scatter, self._backscatter)
        )
        if self._optics.turbidity.silty:
            forward_scatter = forward_scatter + self._blurred.numpy()
        elif share > 0:
            forward_scatter = forward_scatter * np.float32(1 - share) + self._blurred.numpy() * np.float32(share)
        depth, classes, instances = (array.numpy().copy() for array in self._truth)
        found: dict[str, NDArray[np.generic]] = {
            "radiance": radiance,
            "direct": direct,
            "forward_scatter": forward_scatter,
            "backscatter": backscatter,
            "snow": radiance - (direct + forward_scatter + backscatter),
            "depth": depth,
            "classes": classes,
            "instances": instances,
        }
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

    def _prepare(self, T_map_cam: Pose, time_s: float, T_map_base: Pose | None) -> None:
        """Move waves, lamps and vehicle to their places."""
        if T_map_base is None:
            T_map_base = np.asarray(T_map_cam, dtype=float) @ np.linalg.inv(camera_pose(self.camera))
        T_map_base = np.round(T_map_base, 9)
        with self._timed("caustics"):
            self._waves.move(time_s)
            self._optics.caustics = self._waves.light
            self._clear.caustics = self._waves.light
        self._place(T_map_base, time_s)
        with self._timed("turbidity"):
            self._turbidity.move(time_s, np.round(np.asarray(T_map_cam, dtype=float)[:3, 3], 9))
            self._optics.turbidity = self._turbidity.field
        if self._optics.lamps.count:
            lamps.place_lamps(self._optics.lamps, self._lamps, T_map_base, self.device)
            self._clear.lamps.positions = self._optics.lamps.positions
            self._clear.lamps.axes = self._optics.lamps.axes

    def _place(self, T_map_base: Pose, time_s: float) -> None:
        """Move the vehicle and what moves by itself to their places."""
        if self._movers is not None:
            with self._timed("movers"):
                self._movers.move(time_s)
        if self._geometry.vehicle.mesh:
            T_map_base = np.round(T_map_base, 9)
            self._geometry.vehicle.rotation = wp.mat33(*T_map_base[:3, :3].astype(np.float32).ravel().tolist())
            self._geometry.vehicle.position = wp.vec3(*T_map_base[:3, 3].tolist())

    def _view(self, T_map_cam: Pose, passage: Passage = STILL) -> CameraView:
        view = CameraView()
        pose = np.asarray(T_map_cam, dtype=np.float32)
        view.position = wp.vec3(*pose[:3, 3].tolist())
        view.rotation = wp.mat33(*pose[:3, :3].ravel().tolist())
        view.rays = self._ray_table
        view.focal = float(camera_matrix(self.camera)[0, 0])
        view.max_range = self.camera.max_range_m
        view.port = int(self.camera.port_mm is not None)
        if passage.rows is not None:
            rows = passage.rows.astype(np.float32)
            view.rolling = 1
            view.positions = wp.array(rows[:, :3, 3], dtype=wp.vec3, device=self.device)
            view.rotations = wp.array(rows[:, :3, :3], dtype=wp.mat33, device=self.device)
        return view

    def _expose(self, T_map_cam: Pose, time_s: float, passage: Passage, ideal: bool = False) -> wp.array:
        """What arrives at the sensor (H, W) vec3, and the truth of it in its place. ideal: by a lens that is sharp
        everywhere, a shutter that opens for an instant, and a clean port."""
        view = self._view(T_map_cam, passage)
        self._trace(view, self._optics)
        device, shape = self.device, self._radiance.shape
        parted = self._optics.turbidity.silty
        if self._blur_share > 0 or parted:
            with self._timed("blur"):
                soft = self._forward_scatter
                if parted:
                    soft = self._soft
                    inputs = [self._blur_share, self._silted]
                    wp.launch(sensor.part, shape, inputs=inputs, outputs=[self._forward_scatter, soft], device=device)
                self._blur.spread(soft, self._blurred)
        flakes = self._snow.light
        if flakes is not None:
            with self._timed("snow"):
                pose = np.round(np.asarray(T_map_cam, dtype=float), 9)
                self._snow.fall(view, self._optics, self._truth[0], pose, self._rays, time_s, passage)
        seen, spare = self._radiance, self._spare
        with self._timed("compose"):
            light = [self._sharp, self._forward_scatter, self._blurred, self._backscatter, self._blur_share, parted]
            wp.launch(sensor.compose, shape, inputs=light, outputs=[seen], device=device)
        if self._defocus is not None and not ideal:
            with self._timed("defocus"):
                self._defocus.spread(seen, self._hits, spare)
                seen, spare = spare, seen
        if passage.ends is not None and not ideal:
            with self._timed("shutter"):
                then = None
                if self._movers is not None:
                    closes_s = time_s + 0.5 * passage.shutter_s
                    then = flow.carried(self._geometry, self._movers, view, self._hits, closes_s, np.eye(4))
                self._shutter.trace(view, self._hits, T_map_cam, passage.ends, then)
                self._shutter.blur(seen, self._hits, spare)
                seen, spare = spare, seen
        if flakes is not None:
            with self._timed("compose"):
                wp.launch(sensor.add_flakes, shape, inputs=[flakes, snow.UNIT], outputs=[seen], device=device)
        if self._spots is not None and not ideal:
            with self._timed("port"):
                self._spots.cover(seen, spare)
                seen, spare = spare, seen
        return seen

    def _trace(self, view: CameraView, optics: Optics) -> None:
        """Cast, shade and refine the picture of a view into sharp, forward_scatter and backscatter."""
        shape, device = self._radiance.shape, self.device
        scene = [self._geometry, self._looks, optics, view]
        surfaces = [self._hits, self._normals]
        self._cast(view)
        with self._timed("shadow rays"):
            wp.launch(kernels.shadow, shape, inputs=[*scene, *surfaces], outputs=[self._lit], device=device)
        if optics.occlusion > 0:
            with self._timed("sky occlusion"):
                inputs = [*scene, self._fan, *surfaces]
                wp.launch(occlusion.occlude, shape, inputs=inputs, outputs=[self._open], device=device)
        if optics.turbidity.on:
            with self._timed("turbidity"):
                self._turbidity.march(view, optics)
        if optics.lamps.count:
            with self._timed("lamp beams"):
                beams = optics.lamps.beams
                inputs = [view, optics, self._scattering(optics), self._asymmetry]
                wp.launch(lamps.sum_beams, beams.shape[:2], inputs=inputs, outputs=[beams], device=device)
        with self._timed("shading"):
            inputs = [*scene, *surfaces, self._lit, self._open]
            outputs = [*self._jagged, self._level, self._openings, self._silted]
            wp.launch(kernels.shade, shape, inputs=inputs, outputs=outputs, device=device)
        with self._timed("edges"):
            inputs = [self._geometry, view, *surfaces, self._level, *self._jagged]
            outputs = [self._sharp, self._forward_scatter, self._backscatter]
            wp.launch(edges.refine, shape, inputs=inputs, outputs=outputs, device=device)

    def _cast(self, view: CameraView) -> None:
        """The nearest surface in each pixel of a view."""
        with self._timed("primary rays"):
            outputs = [self._hits, self._normals, *self._truth]
            inputs = [self._geometry, view]
            wp.launch(kernels.trace, self._radiance.shape, inputs=inputs, outputs=outputs, device=self.device)

    def _scattering(self, optics: Optics) -> wp.vec3:
        return wp.vec3(0.0, 0.0, 0.0) if optics is self._clear else self._water_scattering

    def _visibility(self, view: CameraView, instances: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Visible over unhidden pixels (N,) of each instance number, NaN where there are none."""
        counts = wp.zeros(self._count + 1, dtype=wp.int32, device=self.device)
        inputs = [self._geometry, view]
        wp.launch(visibility.count_unhidden, instances.shape, inputs=inputs, outputs=[counts], device=self.device)
        alone = counts.numpy()
        seen = np.bincount(instances.ravel(), minlength=len(alone))
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(alone > 0, np.minimum(seen / alone, 1.0), np.nan)
        share[0] = np.nan
        return share.astype(np.float32)

    def _light(self, world: World, recipe: SequenceRecipe, plumes: Plumes | None) -> None:
        """Tables of water and light, what moves in them, and the camera's fixed exposure."""
        device, camera = self.device, self.camera
        light = build_light(recipe.light)
        daylight = Daylight(float(light.sun_direction[2]), light.sky)
        water = build_water(recipe.water, daylight, recipe.reef.depth_m + DEPTH_MARGIN_M)
        fan = sun_fan(light, water, recipe.reef.depth_m)
        if self._movers is not None:
            self._movers.throw_shadows(np.vstack([fan, light.sun_direction]))
        self._looks = upload_looks(world, recipe, np.vstack([fan, light.sun_direction]), device)
        self._optics = upload_optics(water, light, fan, recipe, world.terrain.steepest(), device)
        shape = (camera.height, camera.width)
        self._optics.lamps = lamps.build_lamps(self._lamps, recipe.light.lamps, water, shape, device)
        self._fill = partial(march.TurbidityField, recipe, water, daylight, plumes, world.texture_seed)
        self._turbidity = self._fill(shape, device)
        self._waves = caustics.Waves(recipe.light, water, recipe.reef.depth_m, world.texture_seed, device)
        self._clear = without_water(self._optics, device)
        self._clear.lamps = lamps.without_water(self._optics.lamps, device)
        self._water = water
        self._water_scattering = wp.vec3(*np.round(water.scattering, 7).tolist())
        self._asymmetry = water.asymmetry
        self._fan = wp.array(sky_fan(), dtype=wp.vec3, device=device)
        self._snow = snow.Snow(recipe.water.snow_per_m3, camera, water, world.texture_seed, device)
        self._blur_share = recipe.water.forward_blur
        self._blur = blur.Blur(shape, float(camera_matrix(camera)[0, 0]), water.spread_rad, device)
        metered = exposure(water, recipe.reef.depth_m, recipe.light.daylight, self._lamps, recipe.light.lamps)
        scale = (metered * 2.0**camera.exposure_stops).tolist()
        self.exposure = sensor.Exposure(camera.shutter_ms * 1e-3, camera.gain, scale)
        streams = Streams(world.texture_seed).at("camera", camera.name)
        dark = sensor.dark_signal(camera, streams) if camera.hot_pixels else np.zeros((1, 1, 3), dtype=np.float32)
        self._dark = wp.array(dark, dtype=wp.vec3, device=device)
        self._spots = port.PortSpots(camera, streams, device) if camera.port_spots else None
        self._defocus = None
        if camera.aperture_mm:
            lens = (float(camera_matrix(camera)[0, 0]), camera.aperture_mm * 1e-3, camera.focus_m)
            self._defocus = defocus.Defocus(shape, *lens, device)
        self._vignetting = wp.array(sensor.vignette(self._rays, camera), dtype=wp.float32, device=device)
        self._gamma = wp.array(sensor.gamma_table(), dtype=wp.uint8, device=device)

    def _allocate(self) -> None:
        """Pictures on the device."""
        shape = (self.camera.height, self.camera.width)

        def picture(kind: type) -> wp.array:
            return wp.zeros(shape, dtype=kind, device=self.device)

        self._ray_table = wp.array(self._rays, dtype=wp.vec3, device=self.device)
        self._hits, self._normals = picture(Hit), picture(wp.vec3)
        self._lit, self._open = picture(wp.uint8), picture(wp.float32)
        self._sharp, self._forward_scatter, self._backscatter = (picture(wp.vec3) for _ in range(3))
        self._blurred, self._radiance, self._spare = (picture(wp.vec3) for _ in range(3))
        self._shutter = shutter.Shutter(shape, self.device)
        self._jagged = [picture(wp.vec3) for _ in range(3)]
        self._level, self._openings, self._silted = (picture(wp.float32) for _ in range(3))
        self._soft = picture(wp.vec3)
        self._truth = [picture(wp.float32), picture(wp.uint8), picture(wp.uint16)]
        self._colour = wp.zeros((*shape, 3), dtype=wp.uint8, device=self.device)

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        start = time.process_time()
        yield
        self.seconds[name] += time.process_time() - start
