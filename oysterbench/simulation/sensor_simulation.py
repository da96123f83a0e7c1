"""What a built sequence records: the messages of its cameras, sonars and small sensors, and the truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import ImuSample, MagneticSample, PressureSample, RangeSample
from oysterbench.recipe import CameraRecipe, SensorRecipe, SonarRecipe, count
from oysterbench.scene.waves import build_waves
from oysterbench.sensors import altimeter, clock, dvl, imu, magnetometer, pressure
from oysterbench.sensors.scanner import ScanningSonar
from oysterbench.sequence import topics
from oysterbench.sequence.calibration import camera_calibration
from oysterbench.sequence.topics import EPOCH_NS, Message
from oysterbench.simulation.calibration import rig_calibration
from oysterbench.simulation.simulated_sequence import Stage, look, look_behind

INERTIAL_STEP = 1e-7  # rad/s and m/s^2: four orders below the noise of the best unit's sample
TRUTH_STEP = 1e-6  # m, m/s and rad/s
ATTITUDE_STEP = 1e-7  # of a unit quaternion
PRESSURE_STEP = 1e-3  # Pa
FIELD_STEP = 1e-12  # T
RANGE_STEP = 1e-6  # m
DVL_READINGS = ("velocity", "altitude", "beam_ranges", "beam_velocities")


def settle(values: Array | float, step: float) -> Array:
    """Values rounded to a step, far above the last bits, in which the mathematics of two processors differ.

    So the same recipe gives the same bytes on any machine.
    """
    return np.rint(values / step) * step + 0.0  # and no negative zeros


def frame_messages(stage: Stage, camera: CameraRecipe, first: int, last: int) -> Iterator[Message]:
    """Messages of frames [first, last): colour and calibration of each, layers at their own rate."""
    calibration = camera_calibration(rig_calibration(stage.rig, stage.recipe.site)["cameras"][camera.name])
    stamps, kept = _clock(stage, camera, "camera", camera.name)
    every = round(camera.rate_hz / camera.layer_rate_hz) if camera.layer_rate_hz else 0
    for index in range(first, last):
        if not kept[index]:
            continue
        frame = look(stage, camera, index)
        stamp = int(stamps[index])
        yield topics.camera_info(stamp, camera.name, calibration)
        yield topics.colour_message(stamp, camera.name, frame.colour, camera.jpeg_quality, camera.image_format)
        if every and index % every == 0:
            layers: dict[str, NDArray] = {"depth": frame.depth, "class": frame.classes, "instance": frame.instances}
            layers |= look_behind(stage, camera, index)
            for name in camera.layers:
                yield topics.layer_message(stamp, camera.name, name, layers[name])


def ping_messages(stage: Stage, recipe: SonarRecipe, first: int, last: int) -> Iterator[Message]:
    """Messages of an imaging sonar's pings [first, last)."""
    stamps, kept = _clock(stage, recipe, "sonar", recipe.name)
    bodies = stage.bodies(np.arange(first, last) / recipe.rate_hz)
    for index, body in zip(range(first, last), bodies, strict=True):
        if kept[index]:
            image, cloud = stage.sonars[recipe.name].ping(body, stage.streams, index, int(stamps[index]))
            yield topics.sonar_message(image)
            if cloud is not None:
                yield topics.cloud_message(cloud)


def sensor_messages(stage: Stage) -> Iterator[Message]:
    """Messages of everything that needs no pictures: inertial unit, truth, and the small sensors that the rig has."""
    rig = stage.rig
    yield from _inertial(stage)
    yield from _truth(stage)
    if rig.dvl is not None:
        yield from _dvl(stage)
    if rig.pressure is not None:
        yield from _pressure(stage)
    if rig.magnetometer is not None:
        yield from _magnetic(stage)
    yield from _ranges(stage)
    yield from _scans(stage)


def oyster_csv(stage: Stage) -> bytes:
    """The truth about each oyster (`World.oyster_table`), as CSV."""
    return stage.world.oyster_table().to_csv(index=False, lineterminator="\n", float_format="%.10g").encode()


def _clock(
    stage: Stage, recipe: SensorRecipe | CameraRecipe, *name: str
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Stamps of all of a sensor's samples, and which of them arrive."""
    n = count(stage.recipe.duration_s, recipe.rate_hz)
    stamps = clock.stamps(n, recipe.rate_hz, EPOCH_NS, recipe.clock_offset_ms)
    return stamps, clock.kept(n, recipe, stage.streams.at(*name))


def _times(stage: Stage, recipe: SensorRecipe) -> Array:
    """Times of all of a sensor's samples, s from the start."""
    return np.arange(count(stage.recipe.duration_s, recipe.rate_hz)) / recipe.rate_hz


def _inertial(stage: Stage) -> Iterator[Message]:
    unit = stage.rig.imu
    stamps, kept = _clock(stage, unit, "imu")
    readings = imu.measure(stage.path, unit, _times(stage, unit), stage.streams)
    gyro, accel = (settle(values, INERTIAL_STEP) for values in readings)
    gyro_variance, accel_variance = (
        density**2 * unit.rate_hz for density in (unit.gyro_noise_density, unit.accel_noise_density)
    )
    for stamp, rate, force in compress(zip(stamps, gyro, accel, strict=True), kept):
        yield topics.imu_message(ImuSample(int(stamp), rate, force), gyro_variance, accel_variance)


def _truth(stage: Stage) -> Iterator[Message]:
    n = count(stage.recipe.duration_s, stage.rig.truth_rate_hz)
    times = np.arange(n) / stage.rig.truth_rate_hz
    motion = stage.path.at(times)
    truth = stage.path.trajectory(times, clock.stamps(n, stage.rig.truth_rate_hz, EPOCH_NS))
    velocity = np.einsum("nji,nj->ni", motion.rotation, motion.velocity)
    rows = zip(
        truth.stamps_ns.tolist(),
        settle(truth.positions, TRUTH_STEP),
        settle(truth.quaternions, ATTITUDE_STEP),
        settle(velocity, TRUTH_STEP),
        settle(motion.rate, TRUTH_STEP),
        strict=True,
    )
    for stamp, position, attitude, speed, rate in rows:
        yield topics.truth_message(stamp, position, attitude, speed, rate)
        yield topics.truth_pose_message(stamp, position, attitude)
        yield topics.transform_message(stamp, position, attitude)


def _dvl(stage: Stage) -> Iterator[Message]:
    recipe = stage.rig.dvl
    assert recipe is not None
    stamps, kept = _clock(stage, recipe, "dvl")
    site, bottom = stage.recipe.site, stage.recipe.reef.bottom
    samples = dvl.measure(stage.path, stage.caster, recipe, site, _times(stage, recipe), stamps, stage.streams, bottom)
    for sample in compress(samples, kept):
        readings: dict[str, Any] = {name: settle(getattr(sample, name), dvl.READING_STEP) for name in DVL_READINGS}
        settled = dataclasses.replace(sample, **readings)
        yield from topics.dvl_messages(settled, recipe.min_range_m, recipe.max_range_m, np.radians(recipe.janus_deg))


def _pressure(stage: Stage) -> Iterator[Message]:
    recipe = stage.rig.pressure
    assert recipe is not None
    stamps, kept = _clock(stage, recipe, "pressure")
    site = stage.recipe.site
    waves = build_waves(site, stage.recipe.reef.depth_m, stage.streams)  # the ones that move the vehicle
    values = settle(
        pressure.measure(stage.path, recipe, site, waves, _times(stage, recipe), stage.streams), PRESSURE_STEP
    )
    variance = pressure.noise_variance(recipe, site)
    for stamp, value in compress(zip(stamps, values, strict=True), kept):
        yield topics.pressure_message(PressureSample(int(stamp), float(value), variance))


def _magnetic(stage: Stage) -> Iterator[Message]:
    recipe = stage.rig.magnetometer
    assert recipe is not None
    stamps, kept = _clock(stage, recipe, "magnetometer")
    fields = magnetometer.measure(stage.path, recipe, stage.recipe.site, _times(stage, recipe), stage.streams)
    variance = magnetometer.noise_variance(recipe)
    for stamp, field in compress(zip(stamps, settle(fields, FIELD_STEP), strict=True), kept):
        yield topics.magnetic_message(MagneticSample(int(stamp), field, variance))


def _ranges(stage: Stage) -> Iterator[Message]:
    site, bottom = stage.recipe.site, stage.recipe.reef.bottom
    for recipe in stage.rig.altimeter:
        stamps, kept = _clock(stage, recipe, "altimeter", recipe.name)
        ranges = altimeter.measure(stage.path, stage.caster, recipe, site, _times(stage, recipe), stage.streams, bottom)
        beam = float(np.radians(recipe.beam_deg))
        for stamp, value in compress(zip(stamps, settle(ranges, RANGE_STEP), strict=True), kept):
            sample = RangeSample(int(stamp), recipe.name, float(value))
            yield topics.range_message(sample, recipe.min_range_m, recipe.max_range_m, beam, recipe.noise_m**2)


def _scans(stage: Stage) -> Iterator[Message]:
    for recipe in stage.rig.scanner:
        head = ScanningSonar(stage.caster, recipe, stage.recipe.site, stage.recipe.reef.bottom)
        stamps, kept = _clock(stage, recipe, "scanner", recipe.name)
        bodies = stage.bodies(_times(stage, recipe))
        for index in np.flatnonzero(kept):
            ping = head.ping(bodies[index], stage.streams, int(index), int(stamps[index]))
            yield from topics.scan_messages(ping)


Recorder = Callable[[int, int], Iterator[Message]]
"""Messages of the frames or pings [first, last) of what it belongs to."""


def recorders(stage: Stage) -> dict[str, Recorder]:
    """What records much: a function for each camera and imaging sonar, by name."""

    def frames(camera: CameraRecipe) -> Recorder:
        return lambda first, last: frame_messages(stage, camera, first, last)

    def pings(recipe: SonarRecipe) -> Recorder:
        return lambda first, last: ping_messages(stage, recipe, first, last)

    return {c.name: frames(c) for c in stage.rig.camera} | {s.name: pings(s) for s in stage.rig.sonar}
