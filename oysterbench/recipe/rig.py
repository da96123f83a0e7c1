"""What a vehicle carries: its cameras and lamps, and sensors of any kind that `oysterbench.sensors` defines."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, ClassVar, Protocol, TypeVar

from oysterbench.core.errors import RecipeError
from oysterbench.core.mcap import LARGEST_CHUNK
from oysterbench.recipe.keys import as_plain, build, choice, number
from oysterbench.recipe.lens import check_lens
from oysterbench.recipe.sensors import NamedSensorRecipe, SensorRecipe

LENSES = {"pinhole": (0,), "brown-conrady": (4, 5), "fisheye": (4,)}
"""Lens -> numbers of distortion coefficients that it may have."""

LAYER_BYTES = {
    "depth": 2,
    "class": 1,
    "instance": 2,
    "normals": 12,
    "clean": 12,
    "direct": 12,
    "forward_scatter": 12,
    "backscatter": 12,
    "snow": 12,
    "visibility": 4,
    "dynamic": 1,
    "flow": 8,
    "transmittance": 4,
}
"""Bytes per pixel of each layer in a file."""

LAYERS = tuple(LAYER_BYTES)
"""Ground truth of an image: what each pixel shows, its light without water and the parts of its light in water, how
much of each instance is visible, which pixels show what moves by itself, where each pixel moves until the next frame,
and how much of its light gets through the water."""

LARGEST_LAYER = LARGEST_CHUNK - (1 << 22)
"""Size limit of a layer of a frame, bytes: its chunk may begin with up to 4 MB of other messages."""

IMAGE_FORMATS = ("jpeg", "png")

LONGEST_DEPTH_M = 65.5
"""Greatest depth that a depth image can hold: 16 bits, in mm."""

VEHICLES = ("none", "bluerov2")

R = TypeVar("R", bound=SensorRecipe)


@dataclass(frozen=True, kw_only=True)
class CameraRecipe(NamedSensorRecipe):
    """A camera on the rig."""

    block: ClassVar[str] = "camera"

    width: int = number(16, 8192)  # pixels
    height: int = number(16, 8192)  # pixels
    hfov_deg: float = number(10, 160)
    """Horizontal field of view in water; for brown-conrady that of the pinhole, before distortion. At most 96 behind a
    flat port; of a fisheye, as far as its corners look less than 90 degrees from the axis: 143 at 4:3, undistorted."""
    rate_hz: float = number(0.1, 200)
    layer_rate_hz: float = number(0, 200, 0.0)  # rate of the ground-truth layers; a divisor of rate_hz
    layers: tuple[str, ...] = choice(LAYERS, ("depth", "class", "instance"))  # ground truth that is written to the file
    image_format: str = choice(IMAGE_FORMATS, "jpeg")  # format of the colour images; png is lossless
    jpeg_quality: int = number(50, 100, 95)  # quality of the colour images, if jpeg
    # Bit rate of a video link that the frames pass through first, coded as by H.264; 0: none. Tethers carry 5 to 15
    # Mbit/s of 1080p at 30 Hz, 0.08 to 0.24 bit per pixel, equivalent to 0.25 to 0.75 Mbit/s of 640 x 480 at 10 Hz.
    video_mbit_s: float = number(0, 100, 0.0)
    max_range_m: float = number(1, 100, 20.0)  # ground truth ends there, images do not; at most 65.5 with layer depth
    lens: str = choice(tuple(LENSES), "pinhole")
    """Distortion model; brown-conrady: k1 k2 p1 p2 [k3]; fisheye (Kannala-Brandt): k1 k2 k3 k4."""
    distortion: tuple[float, ...] = number(-10, 10, ())  # its coefficients, as in OpenCV
    port_mm: float | None = number(0, 200, None)
    """Distance from the pupil to a flat port; the lens then works in air behind it."""
    vignetting: float = number(0, 1, 0.0)  # share of the natural cos^4 fall-off that is applied
    exposure_stops: float = number(-6, 6, 0.0)  # stops brighter than metered
    gain: float = number(1, 64, 1.0)  # amplifies fewer photons to the same brightness: more noise
    shutter_ms: float = number(0, 200, 0.0)  # exposure time, for motion blur; 0: an instant
    # Rolling shutter: rows are read readout_ms / height one after another; 15 to 33 ms for the low-light USB cameras of
    # small ROVs. The timestamp is the middle of the exposure of the middle row. 0: all rows at once.
    readout_ms: float = number(0, 50, 0.0)
    focus_m: float = number(0.05, 20, 1.0)
    """Distance at which marine snow is sharp and, with aperture_mm, everything else."""
    # Diameter of the entrance pupil, for the circle of confusion of everything away from focus_m: f / N of a lens of 3
    # to 8 mm at f/2 to f/2.8. 0: surfaces are sharp everywhere, and marine snow is blurred as by 1.2 mm.
    aperture_mm: float = number(0, 8, 0.0)
    # Standard deviation of a point spread function that softens the whole image: lens, demosaicing, video rescaling;
    # 0.5 to 2 px in frames from the videos of small ROVs.
    softness_px: float = number(0, 6, 0.0)
    denoising: float = number(0, 60, 0.0)
    """Noise reduction of the camera: smooths differences in brightness below this many of 255 levels within 6 px, and
    faint texture with them."""
    sharpening: float = number(0, 4, 0.0)  # amount of an unsharp mask of 1.3 px, on brightness
    contrast: float = number(0.3, 3, 1.0)  # factor on levels about middle grey
    saturation: float = number(0, 3, 1.0)  # factor on the distance of colours from grey
    port_spots: int = number(0, 100, 0)
    """Number of spots of algae and bubbles on the port, such as divers and landers wipe off."""
    port_spot_mm: float = number(0.1, 5, 1.0)  # their mean diameter
    hot_pixels: float = number(0, 5000, 0.0)
    """Hot pixels per million: 10 to 1000 in uncooled CMOS sensors, more in warm and old ones (Chapman et al. 2013)."""
    repeats: float = number(0, 0.5, 0.0)  # share of frames that repeat the previous image under a new timestamp
    # A control loop sets the exposure time, then the gain, over the dive, instead of shutter_ms and gain; it settles on
    # a step to 5 % within 0.3 to 2 s. Video at 30 Hz leaves 33 ms at most; amplifiers have steps of 0.3 to 3 dB.
    auto_exposure: bool = field(default=False)
    exposure_settle_s: float = number(0.1, 5, 0.7)  # time within which exposure settles on a change of light
    longest_exposure_ms: float = number(0.1, 100, 25.0)  # upper limit of the exposure time
    highest_gain: float = number(1, 64, 16.0)  # upper limit of the gain
    gain_step_db: float = number(0.1, 6, 1.0)  # steps of the amplifier
    auto_balance: bool = field(default=False)
    """White balance that follows the mean colour, with auto_exposure, instead of being locked; slow, so as not to
    flicker."""
    balance_settle_s: float = number(0.2, 30, 3.0)  # time within which white balance settles

    @property
    def sent_layers(self) -> tuple[str, ...]:
        """Layers that are written to the file."""
        return self.layers if self.layer_rate_hz else ()

    def check(self, where: str) -> None:
        if len(self.distortion) not in LENSES[self.lens]:
            wanted = " or ".join(str(n) for n in LENSES[self.lens])
            raise RecipeError(
                f"{where}: key 'camera.distortion': expected {wanted} coefficients for lens = {self.lens!r}, got "
                f"{list(self.distortion)}"
            )
        check_lens(self, where)
        if len(set(self.layers)) < len(self.layers):
            raise RecipeError(f"{where}: key 'camera.layers': expected each layer once, got {list(self.layers)}")
        if "depth" in self.sent_layers and self.max_range_m > LONGEST_DEPTH_M:
            raise RecipeError(
                f"{where}: key 'camera.max_range_m': expected at most {LONGEST_DEPTH_M:g} beside the layer 'depth', "
                f"which has 16 bits of a millimetre; got {self.max_range_m:g}"
            )
        for layer in self.sent_layers:
            most = LARGEST_LAYER // LAYER_BYTES[layer]
            if self.width * self.height > most:
                raise RecipeError(
                    f"{where}: keys 'camera.width', 'camera.height': expected at most {most:_} pixels beside the layer "
                    f"{layer!r}, as a file takes at most {LARGEST_LAYER >> 20} MiB of it per frame; got {self.width} x "
                    f"{self.height}"
                )
        if self.layer_rate_hz and not (self.rate_hz / self.layer_rate_hz).is_integer():
            raise RecipeError(
                f"{where}: key 'camera.layer_rate_hz': expected a divisor of rate_hz = {self.rate_hz}, got "
                f"{self.layer_rate_hz}"
            )
        if self.auto_exposure and (self.shutter_ms or self.gain != 1.0):
            key = "shutter_ms" if self.shutter_ms else "gain"
            raise RecipeError(
                f"{where}: key 'camera.{key}': expected none beside auto_exposure = true, which sets it, got "
                f"{getattr(self, key):g}"
            )
        if self.auto_balance and not self.auto_exposure:
            raise RecipeError(f"{where}: key 'camera.auto_balance': expected auto_exposure = true beside it, got false")
        super().check(where)


@dataclass(frozen=True, kw_only=True)
class LampRecipe:
    """A lamp on the rig. Pitch is positive below the horizon."""

    intensity_cd: float = number(0, 1e6)  # luminous intensity along its axis
    half_angle_deg: float = number(1, 89, 45.0)  # of the cone, from its axis to the middle of its soft edge
    edge_deg: float = number(0.5, 60, 15.0)  # width of the soft edge
    colour: tuple[float, float, float] = number(0, 2, (1.0, 1.0, 1.0))  # red, green and blue relative to daylight
    position_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # of the lamp in base_link
    pitch_deg: float = number(-90, 90, 0.0)  # of its axis, positive below the horizon
    yaw_deg: float = number(-180, 180, 0.0)  # of its axis from the bow, positive to port


@dataclass(frozen=True, kw_only=True)
class RigRecipe:
    """A vehicle: its body, its cameras and lamps, its IMU, and its other sensors.

    In its file each sensor is a table named after its kind's block, such as `[dvl]` or `[[sonar]]`.
    """

    name: str  # of the rig
    summary: str  # one line about it
    truth_rate_hz: float = number(1, 4000, 200.0)  # poses of the ground truth per second
    camera: tuple[CameraRecipe, ...]  # at least one
    lamp: tuple[LampRecipe, ...] = ()  # none: daylight only
    sensors: tuple[SensorRecipe, ...]  # all but the cameras
    vehicle: str = choice(VEHICLES, "none")  # body that the cameras see and that casts a shadow

    def of(self, kind: type[R]) -> tuple[R, ...]:
        """Sensors whose recipe is of a kind, such as `DvlRecipe`."""
        return tuple(sensor for sensor in (*self.sensors, *self.camera) if type(sensor) is kind)

    def as_tables(self) -> dict[str, Any]:
        """Keys and values of the rig's file, with the sensors under their blocks."""
        tables = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "sensors"}
        for sensor in self.sensors:
            tables[sensor.block] = sensor if sensor.single else (*tables.get(sensor.block, ()), sensor)
        return tables


class SensorBlock(Protocol):
    """What reading a rig's file needs of a sensor kind: its recipe, whether it is required, and implied keys."""

    @property
    def recipe(self) -> type[SensorRecipe]: ...
    @property
    def required(self) -> bool: ...
    def fill_in(self, table: Any) -> Any: ...


def sensor_blocks() -> Mapping[str, SensorBlock]:
    """Block -> sensor kind. Kinds are plug-ins in a layer above recipes, which find them by their package's name."""
    kinds: Mapping[str, SensorBlock] = import_module("oysterbench.sensors.registry").sensor_kinds()
    return kinds


def read_rig(table: Mapping[str, Any], where: str) -> RigRecipe:
    """Read a rig from the content of its TOML file. Raises RecipeError, which starts with `where`."""
    kinds = {block: kind for block, kind in sensor_blocks().items() if block != CameraRecipe.block}
    plain = [f.name for f in dataclasses.fields(RigRecipe) if f.name != "sensors"]
    for key in table:
        if key not in (*plain, *kinds):
            raise RecipeError(f"{where}: unknown key {key!r}; known keys here: {', '.join((*plain, *kinds))}")
    sensors = []
    for block, kind in kinds.items():
        if block not in table:
            if kind.required:
                raise RecipeError(f"{where}: missing key {block!r}")
            continue
        entries = [table[block]] if kind.recipe.single else table[block]
        if not isinstance(entries, list):
            raise RecipeError(f"{where}: key {block!r}: expected a list, got {entries!r}")
        sensors += [build(kind.recipe, kind.fill_in(entry), where, f"{block}.") for entry in entries]
    values = {key: value for key, value in table.items() if key in plain}
    rig: RigRecipe = build(RigRecipe, {**values, "sensors": sensors}, where, "")
    check_rig(rig, where)
    return rig


def vary_rig(rig: RigRecipe, changes: Mapping[str, Any], where: str) -> RigRecipe:
    """Return the rig with some values replaced, block by block, in all sensors (or lamps) of a block.

    A value that implies others, such as a grade, brings them along. Raises RecipeError, which starts with `where`, for
    a block that the rig lacks, and for bad values as for those of a rig's file.
    """
    if not changes:
        return rig
    tables = as_plain(rig)
    kinds = sensor_blocks()
    for block, values in changes.items():
        known = [name for name, table in tables.items() if isinstance(table, dict | list)]
        if block not in known:
            raise RecipeError(
                f"{where}: key 'rig.{block}': rig {rig.name} has no such block; it has {', '.join(known)}"
            )
        if not isinstance(values, Mapping) or "name" in values:
            raise RecipeError(
                f"{where}: key 'rig.{block}': expected a table of keys of [{block}], without name, got {values!r}"
            )
        filled = kinds[block].fill_in(as_plain(values)) if block in kinds else as_plain(values)
        old = tables[block]
        tables[block] = [{**one, **filled} for one in old] if isinstance(old, list) else {**old, **filled}
    return read_rig(tables, f"{where}: rig {rig.name}")


def check_rig(rig: RigRecipe, where: str) -> None:
    """Check what no single key can express. Raises RecipeError, which starts with `where`.

    Topics start with the name of their sensor: names must be valid in ROS 2, and unique.
    """
    seen = {"truth", "tf", "tf_static", *(block for block, kind in sensor_blocks().items() if kind.recipe.single)}
    for sensor in (*rig.camera, *rig.sensors):
        sensor.check(where)
        if not isinstance(sensor, NamedSensorRecipe):
            continue
        key = f"{where}: key '{sensor.block}.name'"
        if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", sensor.name):
            raise RecipeError(f"{key}: expected a letter, then letters, digits and '_', got {sensor.name!r}")
        if sensor.name in seen:
            raise RecipeError(f"{key}: {sensor.name!r} is taken; names must differ")
        seen.add(sensor.name)


def count(duration_s: float, rate_hz: float) -> int:
    """Number of samples at times 0, 1 / rate, 2 / rate, ... below the duration."""
    return math.ceil(duration_s * rate_hz - 1e-9)
