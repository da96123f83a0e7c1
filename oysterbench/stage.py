"""One sequence, built: its path and cameras, and the messages that they send."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.geometry import Array, transform
from oysterbench.recipe import CameraRecipe, RigRecipe, SequenceRecipe, SplitRecipe, count
from oysterbench.render.camera import CameraRenderer, Frame
from oysterbench.samples import ImuSample
from oysterbench.scene.path import Path, build_path
from oysterbench.scene.rig import camera_pose, rig_calibration
from oysterbench.scene.world import World, build_world
from oysterbench.sensors import imu
from oysterbench.sequence import topics
from oysterbench.sequence.read import camera_calibration
from oysterbench.sequence.topics import EPOCH_NS, Message
from oysterbench.streams import Streams


def stamps(n: int, rate_hz: float) -> np.ndarray:
    """(n,) int64 stamps at times k / rate from the epoch."""
    return EPOCH_NS + np.rint(np.arange(n) * (1e9 / rate_hz)).astype(np.int64)


INERTIAL_STEP = 1e-7  # rad/s and m/s^2: four orders below the noise of the best unit's sample
TRUTH_STEP = 1e-6  # m, m/s and rad/s
ATTITUDE_STEP = 1e-7  # of a unit quaternion
FRAME_LAYERS = ("depth", "class", "instance")
SHUTTER_POSES = 4  # besides the frame's own, evenly while the shutter is open


def settle(values: Array, step: float) -> Array:
    """Values rounded to a step, far above the last bits, in which the mathematics of two processors differ.

    So the same recipe gives the same bytes on any machine.
    """
    return np.rint(values / step) * step + 0.0  # and no negative zeros


@dataclass(frozen=True)
class Stage:
    """A built sequence: the reef, the path over it, and a renderer per camera."""

    rig: RigRecipe
    world: World
    path: Path
    renderers: dict[str, CameraRenderer]
    streams: Streams


@lru_cache(maxsize=1)
def build_stage(split: SplitRecipe, name: str, salt: bytes) -> Stage:
    """Built once per process and sequence; a worker's next job is most often of the same sequence."""
    recipe = split.find_sequence(name)
    streams = Streams(split.seed, salt, (recipe.name,))
    world = build_world(recipe, streams)
    path = build_path(recipe, world.ground_height, world.obstacle_height, streams)
    renderers = {camera.name: CameraRenderer(world, camera, recipe, rig=split.rig) for camera in split.rig.camera}
    return Stage(split.rig, world, path, renderers, streams)


def look(stage: Stage, camera: CameraRecipe, index: int) -> Frame:
    """Frame `index` of a camera: what it sees at index / rate_hz seconds."""
    time_s = index / camera.rate_hz
    opened = camera.shutter_ms * 1e-3 * (np.arange(SHUTTER_POSES) / SHUTTER_POSES - 0.5) if camera.shutter_ms else ()
    body, *shutter = _bodies(stage, np.maximum(time_s + np.array([0.0, *opened]), 0.0))
    mount = camera_pose(camera)
    noise = stage.streams.generator("camera", camera.name, "noise", index)
    renderer = stage.renderers[camera.name]
    return renderer.render(body @ mount, noise, time_s, body, [pose @ mount for pose in shutter])


def look_behind(stage: Stage, camera: CameraRecipe, index: int) -> dict[str, NDArray[Any]]:
    """Those layers of frame `index` that no frame carries by itself, as the camera's recipe names them."""
    wanted = [name for name in camera.layers if name not in FRAME_LAYERS]
    if not wanted:
        return {}
    time_s = index / camera.rate_hz
    (body,) = _bodies(stage, np.array([time_s]))
    renderer = stage.renderers[camera.name]
    layers: dict[str, NDArray[Any]] = dict(
        renderer.layers(body @ camera_pose(camera), [*wanted, "instances"], time_s, body)
    )
    if "visibility" in layers:
        layers["visibility"] = layers["visibility"][layers["instances"]]
    return {name: layers[name] for name in wanted}


def _bodies(stage: Stage, times_s: Array) -> list[Array]:
    """T_map_base (4, 4) at times (N,) s."""
    motion = stage.path.at(times_s)
    return [transform(r, p) for r, p in zip(motion.rotation, motion.position, strict=True)]


def render_frames(stage: Stage, camera: CameraRecipe, first: int, last: int) -> Iterator[Message]:
    """Messages of frames [first, last): colour and calibration of each, layers at their own rate."""
    calibration = camera_calibration(rig_calibration(stage.rig)["cameras"][camera.name])
    frame_stamps = stamps(last, camera.rate_hz)
    every = round(camera.rate_hz / camera.layer_rate_hz) if camera.layer_rate_hz else 0
    for index in range(first, last):
        frame = look(stage, camera, index)
        stamp = int(frame_stamps[index])
        yield topics.camera_info(stamp, camera.name, calibration)
        yield topics.colour_message(stamp, camera.name, frame.colour, camera.jpeg_quality)
        if every and index % every == 0:
            layers: dict[str, NDArray[Any]] = {
                "depth": frame.depth,
                "class": frame.classes,
                "instance": frame.instances,
            }
            layers |= look_behind(stage, camera, index)
            for name in camera.layers:
                yield topics.layer_message(stamp, camera.name, name, layers[name])


def measure_sensors(stage: Stage, split: SplitRecipe, recipe: SequenceRecipe) -> Iterator[Message]:
    """Messages of the inertial unit, then of the truth."""
    unit = split.rig.imu
    n = count(recipe.duration_s, unit.rate_hz)
    gyro, accel = imu.measure(stage.path, unit, np.arange(n) / unit.rate_hz, stage.streams)
    gyro_variance, accel_variance = (
        density**2 * unit.rate_hz for density in (unit.gyro_noise_density, unit.accel_noise_density)
    )
    gyro, accel = settle(gyro, INERTIAL_STEP), settle(accel, INERTIAL_STEP)
    for stamp, rate, force in zip(stamps(n, unit.rate_hz), gyro, accel, strict=True):
        yield topics.imu_message(ImuSample(int(stamp), rate, force), gyro_variance, accel_variance)

    n = count(recipe.duration_s, split.rig.truth_rate_hz)
    times = np.arange(n) / split.rig.truth_rate_hz
    motion = stage.path.at(times)
    truth = stage.path.trajectory(times, stamps(n, split.rig.truth_rate_hz))
    velocity = np.einsum("nji,nj->ni", motion.rotation, motion.velocity)
    rows = zip(
        truth.stamps_ns,
        settle(truth.positions, TRUTH_STEP),
        settle(truth.quaternions, ATTITUDE_STEP),
        settle(velocity, TRUTH_STEP),
        settle(motion.rate, TRUTH_STEP),
        strict=True,
    )
    for stamp, position, quaternion, speed, rate in rows:
        yield topics.truth_message(int(stamp), position, quaternion, speed, rate)


def oyster_csv(stage: Stage) -> bytes:
    """The truth about each oyster (`World.oyster_table`), as CSV."""
    return stage.world.oyster_table().to_csv(index=False, lineterminator="\n", float_format="%.10g").encode()
