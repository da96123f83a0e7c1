"""What the sensors of a simulated sequence measure, as messages; and the truth."""

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

TRUTH_STEP = 1e-6  # m, m/s and rad/s
ATTITUDE_STEP = 1e-7  # of a unit quaternion
UNSEEN_RATE_HZ = 1.0  # of the poses of what moves, where no camera has layers


def sensor_messages(
    simulated: SimulatedSequence, recipe: SensorRecipe, first: int = 0, last: int | None = None
) -> Iterator[Message]:
    """Messages of measurements [first, last) of a sensor, all by default: those that are not lost, on its own clock."""
    kind = kind_of(recipe)
    times = kind.times(simulated, recipe)
    n = count(simulated.recipe.duration_s, recipe.rate_hz) if times is None else len(times)
    name = (kind.block,) if kind.single else (kind.block, kind.name_of(recipe))
    stamps = sensor_stamps(simulated, recipe, n, times)
    kept = clock.kept(n, recipe, simulated.streams.at(*name))
    wanted = np.arange(first, n if last is None else last)
    instants = Instants(np.arange(n) / recipe.rate_hz if times is None else times, stamps, wanted[kept[wanted]])
    for measurement in kind.measure(simulated, recipe, instants):
        yield from kind.encode(recipe, measurement)


def sensor_stamps(
    simulated: SimulatedSequence, recipe: SensorRecipe, n: int, times_s: Array | None = None
) -> NDArray[np.int64]:
    """(n,) int64 stamps of a sensor's samples at times (n,) s, or at its rate: by its clock, late by what no
    calibration knows, and with jitter."""
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


def small_messages(simulated: SimulatedSequence) -> Iterator[Message]:
    """Messages of every sensor that is not bulky, and the truth."""
    yield from truth_messages(simulated)
    for kind, recipe in rig_sensors(simulated.rig):
        if not kind.bulky:
            yield from sensor_messages(simulated, recipe)


def truth_messages(simulated: SimulatedSequence) -> Iterator[Message]:
    """The truth, in its three forms, at the rig's rate."""
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
    """How each frame of the cameras that adapt or repeat is taken (`sequence.read.FRAMES`), as CSV; None without any.

    stamp_ns: the frame's; shown_ns: that of the frame whose picture it shows.
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
    """The truth about each oyster (`World.oyster_table`), as CSV."""
    return simulated.world.oyster_table().to_csv(index=False, lineterminator="\n", float_format="%.10g").encode()


def faults_csv(simulated: SimulatedSequence) -> bytes | None:
    """Where the faults of the sensors struck, as CSV (`sensors.faults`); None where they have none."""
    found = [
        (kind.name_of(recipe), fault)
        for kind, recipe in rig_sensors(simulated.rig)
        for fault in kind.faults(simulated, recipe)
    ]
    return fault_csv(found, EPOCH_NS) if found else None


def moving_csvs(simulated: SimulatedSequence) -> tuple[bytes, bytes]:
    """Who moves by itself (`Life.table`), and where it is at the stamps of the layers of the camera that has the most,
    or once a second (`Life.poses`), as CSV."""
    assert simulated.life is not None
    rate = max((camera.layer_rate_hz for camera in simulated.rig.camera), default=0.0) or UNSEEN_RATE_HZ
    n = count(simulated.recipe.duration_s, rate)
    poses = simulated.life.poses(np.arange(n) / rate, clock.stamps(n, rate, EPOCH_NS))
    tables = (simulated.life.table(), poses)
    who, where = (table.to_csv(index=False, lineterminator="\n", float_format="%.10g").encode() for table in tables)
    return who, where
