"""One panel of a gallery: what a camera, a sonar or a scalar sensor records in a split's first sequence."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.ros import EPOCH_NS, Message, decode
from oysterbench.recipe import CameraRecipe, SplitRecipe
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.kind import topic
from oysterbench.sensors.panels import curves, padded
from oysterbench.sensors.registry import kind_of, rig_sensors
from oysterbench.simulation.sensor_simulation import sensor_messages, sensor_stamps
from oysterbench.simulation.simulated_sequence import SimulatedSequence, build_sequence

Picture = NDArray[np.uint8]

ASPECT = 4 / 3
FRAMES_BEFORE = 8  # frames that a video link codes before the one shown, so that its quantiser has settled
TILES = 2  # frames across and down, in time order


def camera_picture(
    split: SplitRecipe, name: str, at_s: float, every_s: float | None = None, layer: str | None = None
) -> Picture:
    """Image (H, W, 3) uint8 RGB that a camera sends at a time; or a ground-truth layer; or, with every_s, four frames
    every_s apart, in rows. Lost frames are dark."""
    simulated = build_sequence(split, split.sequence[0].name, b"")
    camera = next(camera for camera in simulated.rig.camera if camera.name == name)
    if every_s is None:
        return _frame(simulated, camera, round(at_s * camera.rate_hz), layer)
    indices = [round((at_s + k * every_s) * camera.rate_hz) for k in range(TILES**2)]
    tiles = [_frame(simulated, camera, index, layer) for index in indices]
    rows = [np.hstack(tiles[k : k + TILES]) for k in range(0, len(tiles), TILES)]
    size = (camera.width, camera.height)
    return np.asarray(cv2.resize(np.vstack(rows), size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _frame(simulated: SimulatedSequence, camera: CameraRecipe, index: int, layer: str | None) -> Picture:
    from oysterbench.sensors.camera_messages import read_colour, read_layer
    from oysterbench.sensors.camera_panels import layer_picture

    wanted = topic(camera.name, layer or "image")
    if layer:
        camera = dataclasses.replace(camera, layers=(layer,), layer_rate_hz=camera.rate_hz)
    first = max(0, index - FRAMES_BEFORE) if camera.video_mbit_s and not layer else index
    messages = _of(sensor_messages(simulated, camera, first, index + 1), wanted)
    stamp = int(sensor_stamps(simulated, camera, index + 1)[index])
    picture = np.zeros((camera.height, camera.width, 3), dtype=np.uint8)
    for message in kind_of(camera).pass_on(camera, wanted, messages):
        if message.stamp_ns == stamp:
            pixels = read_layer(message.data, layer)[1] if layer else read_colour(message.data)[1]
            picture = layer_picture(layer, pixels) if layer else pixels
    return picture


def sensor_picture(split: SplitRecipe, beside: SplitRecipe, name: str, at_s: float, title: str = "") -> Picture:
    """Image (H, W, 3) uint8 RGB of what a sensor other than a camera measures: of a sonar its fan at a time, of others
    curves over the sequence, with those of the split `beside` in grey.

    title: how the title of the strip to show starts; the first strip by default.
    """
    simulated = build_sequence(split, split.sequence[0].name, b"")
    recipe = _sensor(simulated, name)
    if hasattr(recipe, "beams"):
        return _fan(simulated, recipe, round(at_s * recipe.rate_hz))
    strip = next(strip for strip in kind_of(recipe).strips(name) if strip.title.startswith(title))
    found = _table(simulated, recipe, strip.topic, strip.columns)
    faults = [(fault.start_s, fault.end_s) for fault in kind_of(recipe).faults(simulated, recipe)]
    calm = build_sequence(beside, beside.sequence[0].name, b"")
    reference = _table(calm, _sensor(calm, name), strip.topic, strip.columns)
    seconds, values = found[0], found[1] * strip.factor
    picture = curves(strip.title, seconds, values, reference[0], reference[1] * strip.factor, faults)
    return np.asarray(picture[..., ::-1], dtype=np.uint8)


def _sensor(simulated: SimulatedSequence, name: str) -> SensorRecipe:
    found: SensorRecipe = next(recipe for kind, recipe in rig_sensors(simulated.rig) if kind.name_of(recipe) == name)
    return found


def _fan(simulated: SimulatedSequence, recipe: Any, index: int) -> Picture:
    from oysterbench.sensors.panels import Fan, white_of

    kind = kind_of(recipe)
    calibration = kind.read_calibration(simulated.calibration.given[kind.key][recipe.name])
    image = topic(recipe.name, "image")
    (message,) = _of(sensor_messages(simulated, recipe, index, index + 1), image)
    pixels = kind.decode(recipe.name, calibration, message.data).pixels
    fan = Fan.of(calibration.azimuths_rad, calibration.ranges_m).draw(pixels, white_of(pixels))
    return np.asarray(padded(fan, ASPECT)[..., ::-1], dtype=np.uint8)


def _table(
    simulated: SimulatedSequence, recipe: SensorRecipe, name: str, columns: tuple[str, ...]
) -> tuple[Array, Array]:
    """Seconds (N,) since the epoch and values (N, columns) of a sensor's topic."""
    kind = kind_of(recipe)
    row = next(row for leaf, row in kind.tables.items() if topic(kind.name_of(recipe), leaf) == name)
    form = kind.topics(recipe)[name]
    found = [
        (message.stamp_ns, row(decode(message.data, form))) for message in _of(sensor_messages(simulated, recipe), name)
    ]
    seconds = np.array([(stamp - EPOCH_NS) * 1e-9 for stamp, _ in found])
    return seconds, np.array([[values[column] for column in columns] for _, values in found], dtype=float)


def _of(messages: Iterator[Message], name: str) -> Iterator[Message]:
    return (message for message in messages if message.topic == name)
