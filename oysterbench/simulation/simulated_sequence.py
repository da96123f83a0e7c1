"""One sequence, built: its path, its cameras and sonars, and what they see at any time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, transform
from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe, RigRecipe, SequenceRecipe, SplitRecipe, draw
from oysterbench.render.camera import CameraRenderer, Frame
from oysterbench.render.rays import RayCaster
from oysterbench.scene.path import Path, build_path
from oysterbench.scene.rig import camera_pose
from oysterbench.scene.world import World, build_world
from oysterbench.sensors.sonar import ImagingSonar

FRAME_LAYERS = ("depth", "class", "instance")
SHUTTER_POSES = 4  # besides the frame's own, evenly while the shutter is open


@dataclass(frozen=True)
class SimulatedSequence:
    """A built sequence: the reef and the path over it. Renderers and sonars are made when they are first asked for."""

    rig: RigRecipe
    recipe: SequenceRecipe
    world: World
    path: Path
    streams: Streams
    device: str = "cpu"

    @cached_property
    def renderers(self) -> dict[str, CameraRenderer]:
        """A renderer for each camera."""
        return {c.name: CameraRenderer(self.world, c, self.recipe, self.device, rig=self.rig) for c in self.rig.camera}

    @cached_property
    def caster(self) -> RayCaster:
        """Single rays, for what hears."""
        return RayCaster(self.world, self.device)

    @cached_property
    def sonars(self) -> dict[str, ImagingSonar]:
        """Each imaging sonar in the world."""
        reef, site = self.recipe.reef, self.recipe.site
        return {s.name: ImagingSonar(self.caster, s, site, reef.bottom) for s in self.rig.sonar}

    def bodies(self, times_s: Array) -> list[Array]:
        """T_map_base (4, 4) at times (N,) s."""
        motion = self.path.at(times_s)
        return [transform(r, p) for r, p in zip(motion.rotation, motion.position, strict=True)]


@lru_cache(maxsize=1)
def build_sequence(split: SplitRecipe, name: str, salt: bytes, device: str = "cpu") -> SimulatedSequence:
    """Built once per process and sequence; a worker's next job is most often of the same sequence."""
    streams = Streams(split.seed, salt, (name,))
    recipe = draw(
        split.find_sequence(name),
        lambda key: float(streams.generator("drawn", key).random()),
        f"split {split.name}: sequence {name}",
    )
    world = build_world(recipe, streams)
    path = build_path(recipe, world.ground_height, world.obstacle_height, streams)
    return SimulatedSequence(split.rig, recipe, world, path, streams, device)


def render_frame(simulated: SimulatedSequence, camera: CameraRecipe, index: int) -> Frame:
    """Frame `index` of a camera: what it sees at index / rate_hz seconds."""
    time_s = index / camera.rate_hz
    opened = camera.shutter_ms * 1e-3 * (np.arange(SHUTTER_POSES) / SHUTTER_POSES - 0.5) if camera.shutter_ms else ()
    body, *shutter = simulated.bodies(np.maximum(time_s + np.array([0.0, *opened]), 0.0))
    mount = camera_pose(camera)
    noise = simulated.streams.generator("camera", camera.name, "noise", index)
    renderer = simulated.renderers[camera.name]
    return renderer.render(body @ mount, noise, time_s, body, [pose @ mount for pose in shutter])


def render_layers(simulated: SimulatedSequence, camera: CameraRecipe, index: int) -> dict[str, NDArray[Any]]:
    """Those layers of frame `index` that no frame carries by itself, as the camera's recipe names them."""
    wanted = [name for name in camera.layers if name not in FRAME_LAYERS]
    if not wanted:
        return {}
    time_s = index / camera.rate_hz
    (body,) = simulated.bodies(np.array([time_s]))
    renderer = simulated.renderers[camera.name]
    layers: dict[str, NDArray[Any]] = dict(
        renderer.layers(body @ camera_pose(camera), [*wanted, "instances"], time_s, body)
    )
    if "visibility" in layers:
        layers["visibility"] = layers["visibility"][layers["instances"]]
    return {name: layers[name] for name in wanted}
