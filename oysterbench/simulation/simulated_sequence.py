"""One built sequence: its reef, the path over it, and the renderers and ray caster of its sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

from oysterbench.core.geometry import Array, transform
from oysterbench.core.streams import Streams
from oysterbench.recipe import RigRecipe, SequenceRecipe, SplitRecipe
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.render.camera import CameraRenderer
from oysterbench.render.rays import RayCaster
from oysterbench.scene.life import Life, build_life
from oysterbench.scene.path import Path, build_path
from oysterbench.scene.plumes import Plumes, build_plumes
from oysterbench.scene.vehicle import check_cameras
from oysterbench.scene.world import World, build_world
from oysterbench.sensors.registry import calibrate_rig
from oysterbench.sensors.uncertainty import RigCalibration

T = TypeVar("T")


@dataclass(frozen=True)
class SimulatedSequence:
    """A built sequence: the reef and the path over it. Renderers and sonars are made on first use."""

    rig: RigRecipe
    recipe: SequenceRecipe
    world: World
    path: Path
    streams: Streams
    device: str = "cpu"
    life: Life | None = None

    @cached_property
    def renderers(self) -> dict[str, CameraRenderer]:
        """Renderer of each camera, by name."""
        return {
            camera.name: CameraRenderer(
                self.world, camera, self.recipe, self.device, self.rig, plumes=self.plumes, life=self.life
            )
            for camera in self.rig.camera
        }

    @cached_property
    def plumes(self) -> Plumes | None:
        """Plumes of silt, or None where the recipe has none."""
        return build_plumes(self.recipe, self.path, self.world.ground_height, self.streams)

    @cached_property
    def caster(self) -> RayCaster:
        """Caster of single rays, for the acoustic sensors."""
        return RayCaster(self.world, self.device, self.life)

    @cached_property
    def calibration(self) -> RigCalibration:
        """Given and true calibration of the rig."""
        return calibrate_rig(self.rig, self.recipe.site, self.recipe.calibration, self.streams)

    @cached_property
    def _instruments(self) -> dict[SensorRecipe, Any]:
        return {}

    def instrument(self, recipe: SensorRecipe, build: Callable[[], T]) -> T:
        """Return what `build` makes for a sensor, built on first use."""
        if recipe not in self._instruments:
            self._instruments[recipe] = build()
        made: T = self._instruments[recipe]
        return made

    def bodies(self, times_s: Array) -> list[Array]:
        """Poses T_map_base (4, 4) at times (N,) s."""
        motion = self.path.at(times_s)
        return [transform(r, p) for r, p in zip(motion.rotation, motion.position, strict=True)]


_last: dict[tuple[SplitRecipe, str, bytes, str], SimulatedSequence] = {}


def build_sequence(split: SplitRecipe, name: str, salt: bytes, device: str = "cpu") -> SimulatedSequence:
    """Build a sequence, or return it where it is the one that this process built last: a worker's next job is usually
    of the same sequence. The previous one is released first, as two at a time would take twice the memory."""
    key = (split, name, salt, device)
    found = _last.get(key)
    if found is None:
        stated = split.find_sequence(name)  # first, so that an unknown name does not discard the last one
        forget_sequence()
        found = _last[key] = _build(split, stated, salt, device)
    return found


def forget_sequence() -> None:
    """Release the sequence that was built last."""
    _last.clear()


def _build(split: SplitRecipe, stated: SequenceRecipe, salt: bytes, device: str) -> SimulatedSequence:
    streams = split.streams_of(stated, salt)
    recipe = split.drawn(stated, salt)
    rig = split.rig_of(recipe)
    check_cameras(rig, f"split {split.name}: sequence {stated.name}")
    world = build_world(recipe, streams)
    path = build_path(recipe, world.ground_height, world.obstacle_height, streams)
    life = build_life(recipe, world, path, streams)
    return SimulatedSequence(rig, recipe, world, path, streams, device, life)
