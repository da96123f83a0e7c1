"""A view of a world on the device: the light that arrives in each pixel of a camera, and the surface it comes from."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

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
    sensor,
    shutter,
    snow,
)
from oysterbench.render.casting import Hit
from oysterbench.render.lens import pixel_rays
from oysterbench.render.light import build_light, sky_fan, sun_fan
from oysterbench.render.noise import key_of
from oysterbench.render.optics import Optics
from oysterbench.render.passage import STILL, Passage
from oysterbench.render.radiance import Daylight
from oysterbench.render.target import start_warp
from oysterbench.render.upload import upload_geometry, upload_looks, upload_optics, upload_vehicle, without_water
from oysterbench.render.view import CameraView
from oysterbench.render.water import build_water
from oysterbench.scene.life import Life
from oysterbench.scene.plumes import Plumes
from oysterbench.scene.rig import camera_matrix, camera_pose
from oysterbench.scene.vehicle import build_vehicle
from oysterbench.scene.world import World

Pose = NDArray[np.float64]

SHADE_SEED = 0x5AADE
DEPTH_MARGIN_M = 3.0  # extent of the water's tables below the mean bottom


class ViewTracer:
    """Traces views of a world for one camera; the world is uploaded to the device once.

    rig: the vehicle that carries the camera, with its lamps and body; if None, there are neither. life: things that
    move by themselves. seconds: processor time spent in each stage so far.
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
        self._streams = world.appearance.at("camera", camera.name)
        self._geometry, self._movers, self._kept = upload_geometry(world, device, life)
        if rig is not None:
            body = build_vehicle(rig, with_tether=not recipe.life.tether)
            self._geometry.vehicle, kept = upload_vehicle(body, len(world.instances) + 1, device)
            self._kept += kept
        self._lamps = () if rig is None else rig.lamp
        self.recipe = recipe
        self._light(world, recipe, plumes)
        self._allocate()

    def _prepare(self, T_map_cam: Pose, time_s: float, T_map_base: Pose | None) -> None:
        """Update waves, turbidity, lamps, vehicle and moving things for a camera pose and time."""
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
        """Place the vehicle and the moving things for a time."""
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
        """Radiance at the sensor, (H, W) of vec3; the ground truth is left in `_truth`. ideal: with a lens that is
        sharp everywhere, a shutter that opens for an instant, and a clean port."""
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
        if self._softness is not None and not ideal:
            with self._timed("softness"):
                self._softness.spread(seen, spare)
                seen, spare = spare, seen
        return seen

    def _trace(self, view: CameraView, optics: Optics) -> None:
        """Cast, shade and refine the image of a view into sharp, forward_scatter and backscatter."""
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
        """Find the nearest surface in each pixel of a view."""
        with self._timed("primary rays"):
            outputs = [self._hits, self._normals, *self._truth]
            inputs = [self._geometry, view]
            wp.launch(kernels.trace, self._radiance.shape, inputs=inputs, outputs=outputs, device=self.device)

    def _scattering(self, optics: Optics) -> wp.vec3:
        return wp.vec3(0.0, 0.0, 0.0) if optics is self._clear else self._water_scattering

    def _light(self, world: World, recipe: SequenceRecipe, plumes: Plumes | None) -> None:
        """Build tables of water and light, their moving parts, and the effects of lens and port."""
        device, camera = self.device, self.camera
        light = build_light(recipe.light)
        daylight = Daylight(float(light.sun_direction[2]), light.sky)
        water = build_water(recipe.water, daylight, recipe.reef.depth_m + DEPTH_MARGIN_M)
        fan = sun_fan(light, water, recipe.reef.depth_m)
        if self._movers is not None:
            self._movers.throw_shadows(np.vstack([fan, light.sun_direction]))
        self._looks = upload_looks(world, recipe, np.vstack([fan, light.sun_direction]), device)
        self._optics = upload_optics(water, light, fan, recipe, world.terrain.steepest(), device)
        self._optics.shade_seed = key_of(world.appearance.seed ^ SHADE_SEED, world.appearance, "shade")
        shape = (camera.height, camera.width)
        self._optics.lamps = lamps.build_lamps(self._lamps, recipe.light.lamps, water, shape, device)
        self._fill = partial(march.TurbidityField, recipe, water, daylight, plumes, world.appearance)
        self._turbidity = self._fill(shape, device)
        self._waves = caustics.Waves(recipe.light, water, recipe.reef.depth_m, world.appearance, device)
        self._clear = without_water(self._optics, device)
        self._clear.lamps = lamps.without_water(self._optics.lamps, device)
        self._water = water
        self._water_scattering = wp.vec3(*np.round(water.scattering, 7).tolist())
        self._asymmetry = water.asymmetry
        self._fan = wp.array(sky_fan(), dtype=wp.vec3, device=device)
        self._snow = snow.Snow(recipe.water.snow_per_m3, camera, water, world.appearance, device)
        self._blur_share = recipe.water.forward_blur
        self._blur = blur.Blur(shape, float(camera_matrix(camera)[0, 0]), water.spread_rad, device)
        self._spots = port.PortSpots(camera, self._streams, device) if camera.port_spots else None
        self._softness = develop.Softness(shape, camera.softness_px, device) if camera.softness_px else None
        self._defocus = None
        if camera.aperture_mm:
            lens = (float(camera_matrix(camera)[0, 0]), camera.aperture_mm * 1e-3, camera.focus_m)
            self._defocus = defocus.Defocus(shape, *lens, device)

    def _allocate(self) -> None:
        """Allocate the images on the device."""
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

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        start = time.process_time()
        yield
        self.seconds[name] += time.process_time() - start
