"""Measurements of the sensors of a simulated sequence, as messages; and its ground truth."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.ros import EPOCH_NS, Message
from oysterbench.recipe import count
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors import clock
from oysterbench.sensors.camera import shown
from oysterbench.sensors.exposure import exposures
from oysterbench.sensors.faults import fault_csv
from oysterbench.sensors.kind import Instants, quantise
from oysterbench.sensors.registry import kind_of, rig_sensors
from oysterbench.sequence.truth import transform_message, truth_message, truth_pose_message
from oysterbench.simulation.simulated_sequence import SimulatedSequence

TRUTH_STEP = 1e-6  # m, m/s and rad/s, to which the ground truth is rounded
ATTITUDE_STEP = 1e-7  # the same, for unit quaternions
UNSEEN_RATE_HZ = 1.0  # rate of the poses of what moves, where no camera has layers


def sensor_messages(
    simulated: SimulatedSequence, recipe: SensorRecipe, first: int = 0, last: int | None = None
) -> Iterator[Message]:
    """Yield the messages of a sensor's measurements [first, last), by default all, without lost ones, on its clock."""
    kind = kind_of(recipe)
    times = kind.times(simulated, recipe)
    n = count(simulated.recipe.duration_s, recipe.rate_hz) if times is None else len(times)
    stamps, kept = sensor_stamps(simulated, recipe, n, times), sensor_kept(simulated, recipe, n)
    wanted = np.arange(first, n if last is None else last)
    instants = Instants(np.arange(n) / recipe.rate_hz if times is None else times, stamps, wanted[kept[wanted]])
    for measurement in kind.measure(simulated, recipe, instants):
        yield from kind.encode(recipe, measurement)


def sensor_stamps(
    simulated: SimulatedSequence, recipe: SensorRecipe, n: int, times_s: Array | None = None
) -> NDArray[np.int64]:
    """Timestamps (n,), int64 ns, of a sensor's samples at times (n,) s, or at its rate: by its clock, including the
    time offset that its calibration does not know, and jitter."""
    kind = kind_of(recipe)
    true = kind.true_entry(simulated, recipe)
    offset_ms = recipe.clock_offset_ms + 1e3 * true.get("time_offset_s", 0.0)
    if times_s is None:
        stamps = clock.stamps(n, recipe.rate_hz, EPOCH_NS, offset_ms)
    else:
        stamps = np.rint(1e9 * times_s).astype(np.int64) + (EPOCH_NS + round(offset_ms * 1e6))
    sigma_s = math.hypot(1e-3 * recipe.clock_jitter_ms, true.get("time_jitter_s", 0.0))
    if sigma_s:
        stamps += clock.jitter(n, recipe.rate_hz, sigma_s, simulated.streams.at("clock", kind.block))
    return stamps


def sensor_kept(simulated: SimulatedSequence, recipe: SensorRecipe, n: int) -> NDArray[np.bool_]:
    """Mask (n,) of a sensor's samples that are not lost (`clock.kept`)."""
    kind = kind_of(recipe)
    name = (kind.block,) if kind.single else (kind.block, kind.name_of(recipe))
    return clock.kept(n, recipe, simulated.streams.at(*name))


def small_messages(simulated: SimulatedSequence) -> Iterator[Message]:
    """Yield the messages of the ground truth and of every sensor that is not bulky."""
    yield from truth_messages(simulated)
    for kind, recipe in rig_sensors(simulated.rig):
        if not kind.bulky:
            yield from sensor_messages(simulated, recipe)


def truth_messages(simulated: SimulatedSequence) -> Iterator[Message]:
    """Yield the ground-truth trajectory, in its three message types, at the rig's rate."""
    n = count(simulated.recipe.duration_s, simulated.rig.truth_rate_hz)
    times = np.arange(n) / simulated.rig.truth_rate_hz
    motion = simulated.path.at(times)
    truth = simulated.path.trajectory(times, clock.stamps(n, simulated.rig.truth_rate_hz, EPOCH_NS))
    velocity = np.einsum("nji,nj->ni", motion.rotation, motion.velocity)
    rows = zip(
        truth.stamps_ns.tolist(),
        quantise(truth.positions, TRUTH_STEP),
        quantise(truth.quaternions, ATTITUDE_STEP),
        quantise(velocity, TRUTH_STEP),
        quantise(motion.rate, TRUTH_STEP),
        strict=True,
    )
    for stamp, position, attitude, speed, rate in rows:
        yield truth_message(stamp, position, attitude, speed, rate)
        yield truth_pose_message(stamp, position, attitude)
        yield transform_message(stamp, position, attitude)


def frames_csv(simulated: SimulatedSequence) -> bytes | None:
    """CSV of how each frame of adaptive or repeating cameras is taken (`sequence.read.FRAMES`); None without any.

    stamp_ns: stamp of the frame; shown_ns: stamp of the frame whose image it shows.
    """
    import pandas as pd

    tables = []
    for camera in simulated.rig.camera:
        if not camera.auto_exposure and not camera.repeats:
            continue
        pictures = shown(simulated, camera)
        stamps = sensor_stamps(simulated, camera, len(pictures), None)
        table = pd.DataFrame({"camera": camera.name, "stamp_ns": stamps, "shown_ns": stamps[pictures]})
        if camera.auto_exposure:
            chosen = exposures(simulated, camera)
            table["exposure_ms"] = 1e3 * chosen.shutter_s[pictures]
            table["gain"] = chosen.gain[pictures]
            table[["red", "green", "blue"]] = chosen.balance[pictures]
        tables.append(table)
    if not tables:
        return None
    return pd.concat(tables).to_csv(index=False, lineterminator="\n", float_format="%.7g").encode()


def oyster_csv(simulated: SimulatedSequence) -> bytes:
    """CSV of the ground truth about each oyster (`World.oyster_table`)."""
    return simulated.world.oyster_table().to_csv(index=False, lineterminator="\n", float_format="%.10g").encode()


def faults_csv(simulated: SimulatedSequence) -> bytes | None:
    """CSV of the faults that struck the sensors (`sensors.faults`); None where there are none."""
    found = [
        (kind.name_of(recipe), fault)
        for kind, recipe in rig_sensors(simulated.rig)
        for fault in kind.faults(simulated, recipe)
    ]
    return fault_csv(found, EPOCH_NS) if found else None


def moving_csvs(simulated: SimulatedSequence) -> tuple[bytes, bytes]:
    """CSVs of what moves by itself (`Life.table`), and of its poses (`Life.poses`), at the highest layer rate of the
    cameras, or once a second."""
    assert simulated.life is not None
    rate = max((camera.layer_rate_hz for camera in simulated.rig.camera), default=0.0) or UNSEEN_RATE_HZ
    n = count(simulated.recipe.duration_s, rate)
    poses = simulated.life.poses(np.arange(n) / rate, clock.stamps(n, rate, EPOCH_NS))
    tables = (simulated.life.table(), poses)
    who, where = (table.to_csv(index=False, lineterminator="\n", float_format="%.10g").encode() for table in tables)
    return who, where
