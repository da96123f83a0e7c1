"""What a vehicle carries: its cameras and lamps, and the sensors of `recipe.sensors`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from oysterbench.recipe.keys import choice, number
from oysterbench.recipe.sensors import (
    AltimeterRecipe,
    DvlRecipe,
    ImuRecipe,
    MagnetometerRecipe,
    PressureRecipe,
    ScannerRecipe,
    SonarRecipe,
)

LENSES = {"pinhole": (0,), "brown-conrady": (4, 5), "fisheye": (4,)}
"""How many coefficients of distortion each lens has."""

LAYERS = (
    "depth",
    "class",
    "instance",
    "normals",
    "clean",
    "direct",
    "forward_scatter",
    "backscatter",
    "snow",
    "visibility",
)
"""Ground truth behind a picture: what each pixel shows, its light without water and on its path through the water, and
how much of each instance can be seen."""

IMAGE_FORMATS = ("jpeg", "png")

VEHICLES = ("none", "bluerov2")


@dataclass(frozen=True, kw_only=True)
class CameraRecipe:
    """A camera on the rig. Pitch is positive below the horizon."""

    name: str
    width: int = number(16, 8192)
    height: int = number(16, 8192)
    hfov_deg: float = number(10, 160)  # in water; of the pinhole, for a lens of brown-conrady before its distortion
    rate_hz: float = number(0.1, 200)
    layer_rate_hz: float = number(0, 200, 0.0)  # of the layers; a divisor of rate_hz
    layers: tuple[str, ...] = choice(LAYERS, ("depth", "class", "instance"))  # ground truth that goes into the file
    position_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # in base_link
    pitch_deg: float = number(-90, 90, 0.0)
    yaw_deg: float = number(-180, 180, 0.0)
    image_format: str = choice(IMAGE_FORMATS, "jpeg")  # of its colour frames in the file; png keeps every bit
    jpeg_quality: int = number(50, 100, 95)
    max_range_m: float = number(1, 100, 20.0)  # farther than this is water
    lens: str = choice(
        tuple(LENSES), "pinhole"
    )  # brown-conrady: k1 k2 p1 p2 [k3]; fisheye (Kannala-Brandt): k1 k2 k3 k4
    distortion: tuple[float, ...] = number(-10, 10, ())  # coefficients as OpenCV has them
    port_mm: float | None = number(0, 200, None)  # from the pupil to a flat port; then the lens works in air behind it
    vignetting: float = number(0, 1, 0.0)  # share of the natural fall of light with cos^4 of the angle off the axis
    exposure_stops: float = number(-6, 6, 0.0)  # brighter than metered
    gain: float = number(1, 64, 1.0)  # amplification of fewer photons to the same brightness: more noise
    shutter_ms: float = number(0, 200, 0.0)  # time that the shutter is open, for motion blur; 0: an instant
    focus_m: float = number(0.05, 20, 1.0)  # distance at which marine snow is sharp
    clock_offset_ms: float = number(-1000, 1000, 0.0)  # of its stamps: positive when they are late
    dropout: float = number(0, 0.99, 0.0)  # share of its frames that are lost
    dropout_burst: float = number(1, 1000, 1.0)  # frames lost in a row, on average

    @property
    def sent_layers(self) -> tuple[str, ...]:
        """The layers that go into the file."""
        return self.layers if self.layer_rate_hz else ()


@dataclass(frozen=True, kw_only=True)
class LampRecipe:
    """A lamp on the rig. Pitch is positive below the horizon."""

    intensity_cd: float = number(0, 1e6)  # along its axis
    half_angle_deg: float = number(1, 89, 45.0)  # of the cone, to the middle of its edge
    edge_deg: float = number(0.5, 60, 15.0)  # width of the soft edge
    colour: tuple[float, float, float] = number(0, 2, (1.0, 1.0, 1.0))  # of its light over daylight's
    position_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # in base_link
    pitch_deg: float = number(-90, 90, 0.0)
    yaw_deg: float = number(-180, 180, 0.0)


@dataclass(frozen=True, kw_only=True)
class RigRecipe:
    """A vehicle: its body, its cameras and lamps, its inertial unit, and whatever else it measures with."""

    name: str
    summary: str
    truth_rate_hz: float = number(1, 4000, 200.0)
    imu: ImuRecipe
    camera: tuple[CameraRecipe, ...]
    lamp: tuple[LampRecipe, ...] = ()
    sonar: tuple[SonarRecipe, ...] = ()
    scanner: tuple[ScannerRecipe, ...] = ()
    altimeter: tuple[AltimeterRecipe, ...] = ()
    dvl: DvlRecipe | None = None
    pressure: PressureRecipe | None = None
    magnetometer: MagnetometerRecipe | None = None
    vehicle: str = choice(VEHICLES, "none")  # body that the cameras see and that casts a shadow


def count(duration_s: float, rate_hz: float) -> int:
    """Number of samples at times 0, 1 / rate, 2 / rate, ... below the duration."""
    return math.ceil(duration_s * rate_hz - 1e-9)
