"""What a built sequence records: the messages of its cameras, sonars and small sensors, and the truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import ImuMeasurement, MagneticMeasurement, PressureMeasurement, RangeMeasurement
from oysterbench.recipe import CameraRecipe, SensorRecipe, SonarRecipe, count
from oysterbench.scene.waves import build_waves
from oysterbench.sensors import altimeter, clock, dvl, imu, magnetometer, pressure
from oysterbench.sensors.scanner import ScanningSonar
from oysterbench.sequence import topics
from oysterbench.sequence.calibration import camera_calibration
from oysterbench.sequence.topics import EPOCH_NS, Message
from oysterbench.simulation.calibration import rig_calibration
from oysterbench.simulation.simulated_sequence import SimulatedSequence, render_frame, render_layers

INERTIAL_STEP = 1e-7  # rad/s and m/s^2: four orders below the noise of the best unit's sample
TRUTH_STEP = 1e-6  # m, m/s and rad/s
ATTITUDE_STEP = 1e-7  # of a unit quaternion
PRESSURE_STEP = 1e-3  # Pa
FIELD_STEP = 1e-12  # T
RANGE_STEP = 1e-6  # m
DVL_READINGS = ("velocity", "altitude", "beam_ranges", "beam_velocities")


def quantise(values: Array | float, step: float) -> Array:
    """Values rounded to a step, far above the last bits, in which the mathematics of two processors differ.

    So the same recipe gives the same bytes on any machine.
    """
    return np.rint(values / step) * step + 0.0  # and no negative zeros


def frame_messages(simulated: SimulatedSequence, camera: CameraRecipe, first: int, last: int) -> Iterator[Message]:
    """Messages of frames [first, last): colour and calibration of each, layers at their own rate."""
    calibration = camera_calibration(rig_calibration(simulated.rig, simulated.recipe.site)["cameras"][camera.name])
    stamps, kept = _clock(simulated, camera, "camera", camera.name)
    every = round(camera.rate_hz / camera.layer_rate_hz) if camera.layer_rate_hz else 0
    for index in range(first, last):
        if not kept[index]:
            continue
        frame = render_frame(simulated, camera, index)
        stamp = int(stamps[index])
        yield topics.camera_info(stamp, camera.name, calibration)
        yield topics.colour_message(stamp, camera.name, frame.colour, camera.jpeg_quality, camera.image_format)
        if every and index % every == 0:
            layers: dict[str, NDArray] = {"depth": frame.depth, "class": frame.classes, "instance": frame.instances}
            layers |= render_layers(simulated, camera, index)
            for name in camera.layers:
                yield topics.layer_message(stamp, camera.name, name, layers[name])


def ping_messages(simulated: SimulatedSequence, recipe: SonarRecipe, first: int, last: int) -> Iterator[Message]:
    """Messages of an imaging sonar's pings [first, last)."""
    stamps, kept = _clock(simulated, recipe, "sonar", recipe.name)
    bodies = simulated.bodies(np.arange(first, last) / recipe.rate_hz)
    for index, body in zip(range(first, last), bodies, strict=True):
        if kept[index]:
            image, cloud = simulated.sonars[recipe.name].ping(body, simulated.streams, index, int(stamps[index]))
            yield topics.sonar_message(image)
            if cloud is not None:
                yield topics.cloud_message(cloud)


def sensor_messages(simulated: SimulatedSequence) -> Iterator[Message]:
    """Messages of everything that needs no pictures: inertial unit, truth, and the small sensors that the rig has."""
    rig = simulated.rig
    yield from _inertial(simulated)
    yield from _truth(simulated)
    if rig.dvl is not None:
        yield from _dvl(simulated)
    if rig.pressure is not None:
        yield from _pressure(simulated)
    if rig.magnetometer is not None:
        yield from _magnetic(simulated)
    yield from _ranges(simulated)
    yield from _scans(simulated)


def oyster_csv(simulated: SimulatedSequence) -> bytes:
    """The truth about each oyster (`World.oyster_table`), as CSV."""
    return simulated.world.oyster_table().to_csv(index=False, lineterminator="\n", float_format="%.10g").encode()


def _clock(
    simulated: SimulatedSequence, recipe: SensorRecipe | CameraRecipe, *name: str
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Stamps of all of a sensor's samples, and which of them arrive."""
    n = count(simulated.recipe.duration_s, recipe.rate_hz)
    stamps = clock.stamps(n, recipe.rate_hz, EPOCH_NS, recipe.clock_offset_ms)
    return stamps, clock.kept(n, recipe, simulated.streams.at(*name))


def _times(simulated: SimulatedSequence, recipe: SensorRecipe) -> Array:
    """Times of all of a sensor's samples, s from the start."""
    return np.arange(count(simulated.recipe.duration_s, recipe.rate_hz)) / recipe.rate_hz


def _inertial(simulated: SimulatedSequence) -> Iterator[Message]:
    unit = simulated.rig.imu
    stamps, kept = _clock(simulated, unit, "imu")
    readings = imu.measure(simulated.path, unit, _times(simulated, unit), simulated.streams)
    gyro, accel = (quantise(values, INERTIAL_STEP) for values in readings)
    gyro_variance, accel_variance = (
        density**2 * unit.rate_hz for density in (unit.gyro_noise_density, unit.accel_noise_density)
    )
    for stamp, rate, force in compress(zip(stamps, gyro, accel, strict=True), kept):
        yield topics.imu_message(ImuMeasurement(int(stamp), rate, force), gyro_variance, accel_variance)


def _truth(simulated: SimulatedSequence) -> Iterator[Message]:
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
        yield topics.truth_message(stamp, position, attitude, speed, rate)
        yield topics.truth_pose_message(stamp, position, attitude)
        yield topics.transform_message(stamp, position, attitude)


def _dvl(simulated: SimulatedSequence) -> Iterator[Message]:
    recipe = simulated.rig.dvl
    assert recipe is not None
    stamps, kept = _clock(simulated, recipe, "dvl")
    site, bottom = simulated.recipe.site, simulated.recipe.reef.bottom
    samples = dvl.measure(
        simulated.path, simulated.caster, recipe, site, _times(simulated, recipe), stamps, simulated.streams, bottom
    )
    for sample in compress(samples, kept):
        readings: dict[str, Any] = {name: quantise(getattr(sample, name), dvl.READING_STEP) for name in DVL_READINGS}
        quantised = dataclasses.replace(sample, **readings)
        yield from topics.dvl_messages(quantised, recipe.min_range_m, recipe.max_range_m, np.radians(recipe.janus_deg))


def _pressure(simulated: SimulatedSequence) -> Iterator[Message]:
    recipe = simulated.rig.pressure
    assert recipe is not None
    stamps, kept = _clock(simulated, recipe, "pressure")
    site = simulated.recipe.site
    waves = build_waves(site, simulated.recipe.reef.depth_m, simulated.streams)  # the ones that move the vehicle
    values = quantise(
        pressure.measure(simulated.path, recipe, site, waves, _times(simulated, recipe), simulated.streams),
        PRESSURE_STEP,
    )
    variance = pressure.noise_variance(recipe, site)
    for stamp, value in compress(zip(stamps, values, strict=True), kept):
        yield topics.pressure_message(PressureMeasurement(int(stamp), float(value), variance))


def _magnetic(simulated: SimulatedSequence) -> Iterator[Message]:
    recipe = simulated.rig.magnetometer
    assert recipe is not None
    stamps, kept = _clock(simulated, recipe, "magnetometer")
    fields = magnetometer.measure(
        simulated.path, recipe, simulated.recipe.site, _times(simulated, recipe), simulated.streams
    )
    variance = magnetometer.noise_variance(recipe)
    for stamp, field in compress(zip(stamps, quantise(fields, FIELD_STEP), strict=True), kept):
        yield topics.magnetic_message(MagneticMeasurement(int(stamp), field, variance))


def _ranges(simulated: SimulatedSequence) -> Iterator[Message]:
    site, bottom = simulated.recipe.site, simulated.recipe.reef.bottom
    for recipe in simulated.rig.altimeter:
        stamps, kept = _clock(simulated, recipe, "altimeter", recipe.name)
        ranges = altimeter.measure(
            simulated.path, simulated.caster, recipe, site, _times(simulated, recipe), simulated.streams, bottom
        )
        beam = float(np.radians(recipe.beam_deg))
        for stamp, value in compress(zip(stamps, quantise(ranges, RANGE_STEP), strict=True), kept):
            sample = RangeMeasurement(int(stamp), recipe.name, float(value))
            yield topics.range_message(sample, recipe.min_range_m, recipe.max_range_m, beam, recipe.noise_m**2)


def _scans(simulated: SimulatedSequence) -> Iterator[Message]:
    for recipe in simulated.rig.scanner:
        head = ScanningSonar(simulated.caster, recipe, simulated.recipe.site, simulated.recipe.reef.bottom)
        stamps, kept = _clock(simulated, recipe, "scanner", recipe.name)
        bodies = simulated.bodies(_times(simulated, recipe))
        for index in np.flatnonzero(kept):
            ping = head.ping(bodies[index], simulated.streams, int(index), int(stamps[index]))
            yield from topics.scan_messages(ping)


Recorder = Callable[[int, int], Iterator[Message]]
"""Messages of the frames or pings [first, last) of what it belongs to."""


def recorders(simulated: SimulatedSequence) -> dict[str, Recorder]:
    """What records much: a function for each camera and imaging sonar, by name."""

    def frames(camera: CameraRecipe) -> Recorder:
        return lambda first, last: frame_messages(simulated, camera, first, last)

    def pings(recipe: SonarRecipe) -> Recorder:
        return lambda first, last: ping_messages(simulated, recipe, first, last)

    return {c.name: frames(c) for c in simulated.rig.camera} | {s.name: pings(s) for s in simulated.rig.sonar}
