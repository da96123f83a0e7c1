"""Mechanically scanned sonar: one narrow beam on a head that turns one step with every ping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import ScanPing
from oysterbench.core.ros import IMAGE, Message, decode, echo_image, encode, header, make, read_echo_image, stamp_of
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import BinnedSonarRecipe
from oysterbench.sensors import acoustics, echoes
from oysterbench.sensors.echoes import Rays
from oysterbench.sensors.faults import Fault
from oysterbench.sensors.interference import Beams, added_power, struck_pings
from oysterbench.sensors.kind import Instants, SensedWorld, SensorKind, link

if TYPE_CHECKING:
    from oysterbench.render.rays import RayCaster
    from oysterbench.sensors.panels import Frame, Panel

HEAD = "sensor_msgs/msg/JointState"
COLUMNS, ROWS = 24, 240  # columns and rows of rays over the beam's main lobe


@dataclass(frozen=True, kw_only=True)
class ScannerRecipe(BinnedSonarRecipe):
    """A mechanically scanned sonar: one narrow beam, turned a step at each ping about the z axis of its mount."""

    block: ClassVar[str] = "scanner"

    beam_deg: float = number(0.1, 20, 2.0)  # horizontal width of the beam at half power
    vfov_deg: float = number(1, 90, 25.0)  # vertical width of the beam
    step_deg: float = number(0.1, 30, 0.9)  # turn between pings
    sector_deg: float = number(1, 360, 360.0)  # scanned back and forth if less than 360
    bins: int = number(16, 4096, 1200)
    min_range_m: float = number(0.05, 20, 0.75)
    bandwidth_khz: float = number(1, 1000, 50.0)


@dataclass(frozen=True)
class ScannerCalibration:
    """A scanning sonar: ranges (bins,) m; width of its beam, rad; amplitude of one count; pose at angle 0."""

    ranges_m: Array
    beam_rad: float
    amplitude_step: float
    T_base_sensor: Array


class ScanningSonar:
    """A scanning sonar in a world, over a bottom type of recipe.BOTTOMS.

    Amplitudes are linear, in counts of `amplitude_step`, like those of an imaging sonar. Each ping is sent and received
    at the same pose: scans are distorted only because the vehicle moves between pings.
    """

    def __init__(self, caster: RayCaster, recipe: ScannerRecipe, site: SiteRecipe, bottom: str = "sand") -> None:
        self.caster = caster
        self.recipe = recipe
        self.site = site
        self.amplitude_step = echoes.amplitude_step(recipe)
        self._mount = acoustics.mount_pose(recipe)
        self._mu = acoustics.backscatter(bottom)
        self._across, self._vertical = float(np.radians(recipe.beam_deg)), float(np.radians(recipe.vfov_deg))
        self._fill = acoustics.aperture(self._across) * acoustics.aperture(self._vertical)

    @property
    def ranges(self) -> Array:
        """Ranges (bins,) m of the bin centres, as the sonar believes them to be."""
        return echoes.bin_middles(self.recipe)

    def ping(self, T_map_base: Array, streams: Streams, index: int, stamp_ns: int = 0) -> ScanPing:
        """Take ping `index`, with the vehicle at T_map_base (4, 4) and the head turned by that many steps."""
        branch = streams.at("scanner", self.recipe.name, index)
        angle = head_angle(self.recipe, index)
        power, loss = self.listen(T_map_base, angle, branch)
        beams = Beams(T_map_base @ self._mount, np.array([angle]), self._across)
        power = power + added_power(self.recipe, loss, beams, streams, branch)[0]
        amplitudes = echoes.record(power, self.recipe, loss, branch.generator("noise"))
        return ScanPing(stamp_ns, self.recipe.name, angle, amplitudes)

    def listen(self, T_map_base: Array, angle: float, streams: Streams) -> tuple[Array, float]:
        """Expected power (bins,) of a ping with the head at an angle (rad), and the absorption in dB/m."""
        T_map_sonar = np.asarray(T_map_base, dtype=float) @ self._mount
        medium = echoes.Medium.at(self.site, -float(T_map_sonar[2, 3]), self.recipe.frequency_khz)
        axis = echoes.range_axis(self.recipe, medium.speed)
        rays = self._rays(angle, streams.generator("rays"))
        returns = echoes.send(self.caster, T_map_sonar, rays, self._mu, medium.loss, self._fill, axis.reach)
        power = echoes.add_up(axis, rays.columns, 1, returns.nearest, returns.farthest, returns.powers)
        return echoes.resolve(power, axis, medium.speed, self.recipe.bandwidth_khz)[0], medium.loss

    def _rays(self, angle: float, generator: np.random.Generator) -> Rays:
        """Draw one ray at random in each cell of a grid over the main lobe."""
        widest, highest = acoustics.first_null(self._across), acoustics.first_null(self._vertical)
        width, height = 2 * widest / COLUMNS, 2 * highest / ROWS
        anywhere = generator.random((2, COLUMNS, ROWS))
        across, along = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS), indexing="ij")
        off = width * (across + anywhere[0]) - widest
        elevations = height * (along + anywhere[1]) - highest
        middles = [angle + width * (across + 0.5) - widest, height * (along + 0.5) - highest]
        weights = acoustics.beam_pattern(off, self._across) * acoustics.beam_pattern(elevations, self._vertical)
        return Rays(
            azimuths=(angle + off).ravel(),
            elevations=elevations.ravel(),
            middles=np.reshape(middles, (2, -1)),
            widths=np.full(off.size, width),
            heights=np.full(off.size, height),
            columns=np.zeros(off.size, dtype=np.int64),
            weights=weights.ravel(),
        )


def head_angle(recipe: ScannerRecipe, index: int) -> float:
    """Angle (rad, left of the mount's x, in (-pi, pi]) of the head at ping `index`.

    A full turn starts ahead and goes on to the left; a sector is swept to and fro, first from right to left.
    """
    if recipe.sector_deg >= 360:
        turned = (index * recipe.step_deg) % 360.0
        return float(np.radians(turned - 360.0 if turned > 180.0 else turned))
    steps = max(1, int(np.floor(recipe.sector_deg / recipe.step_deg + 1e-9)))
    place = index % (2 * steps)
    return float(np.radians((min(place, 2 * steps - place) - steps / 2) * recipe.step_deg))


class Scanner(SensorKind[ScannerRecipe, ScannerCalibration, ScanPing]):
    """Sensor kind: scanning sonar."""

    recipe = ScannerRecipe
    calibration = ScannerCalibration
    title = "scanning sonar"
    reader = "scans"
    rank = 60
    leaves: ClassVar = {"ping": IMAGE, "head": HEAD}
    tables: ClassVar = {"head": lambda message: {"angle": float(message.position[0])}}

    def calibrate(self, recipe: ScannerRecipe, site: SiteRecipe) -> dict[str, Any]:
        return {**echoes.calibrate(recipe), "beam_rad": float(np.radians(recipe.beam_deg))}

    def measure(self, world: SensedWorld, recipe: ScannerRecipe, at: Instants) -> Iterator[ScanPing]:
        head = ScanningSonar(world.caster, recipe, world.recipe.site, world.recipe.reef.bottom)
        return echoes.pings(world, at, head.ping)

    def faults(self, world: SensedWorld, recipe: ScannerRecipe) -> list[Fault]:
        """Pulses of other sonars that reach into its beam; value: their azimuth."""
        branch, beam = world.streams.at("scanner", recipe.name), float(np.radians(recipe.beam_deg))
        mount = acoustics.mount_pose(recipe)
        return struck_pings(world, recipe, mount, branch.at, beam, lambda index: head_angle(recipe, index))

    def encode(self, recipe: ScannerRecipe, measurement: ScanPing) -> list[Message]:
        """Messages: amplitudes, near first, as an image of one row; and the angle of the head, rad."""
        head = make(
            HEAD,
            header=header(measurement.stamp_ns, link(measurement.sensor)),
            name=[f"{measurement.sensor}_head"],
            position=np.array([measurement.angle], dtype=float),
            velocity=np.array([], dtype=float),
            effort=np.array([], dtype=float),
        )
        data = echo_image(measurement.stamp_ns, link(measurement.sensor), measurement.amplitudes[None])
        return [
            Message(f"/{measurement.sensor}/ping", measurement.stamp_ns, data),
            Message(f"/{measurement.sensor}/head", measurement.stamp_ns, encode(head)),
        ]

    def decode(self, name: str, calibration: ScannerCalibration, *data: bytes) -> ScanPing:
        stamp, pixels = read_echo_image(data[0], name, (1, len(calibration.ranges_m)))
        joint = decode(data[1], HEAD)
        if stamp_of(joint.header) != stamp:
            raise ValueError(f"{name}'s ping and head at {stamp} are not of one stamp")
        return ScanPing(stamp, name, float(joint.position[0]), pixels[0])

    def panels(self, sequence: Any, name: str) -> list[Panel]:
        from oysterbench.sensors.panels import WIDTH, Panel

        title = f"{name}, to {sequence.scanners[name].ranges_m[-1]:.1f} m"
        return [Panel(title, WIDTH, WIDTH, partial(_frames, sequence, name), WIDTH * WIDTH // 6)]


def _frames(sequence: Any, name: str, times: NDArray[np.int64]) -> Iterator[Frame]:
    """Yield an image of the scan so far at each of the times, with the latest ping at each angle."""
    import cv2

    from oysterbench.sensors.panels import WIDTH, Fan, Frame, jpeg, white_of

    ranges = sequence.scanners[name].ranges_m
    angles = np.linspace(-np.pi, np.pi, 361)
    heard = np.zeros((len(ranges), len(angles)), dtype=np.uint16)
    fan = Fan.of(angles, ranges)
    pings = sequence.scans(name)
    ping = next(pings, None)
    half, latest_ns = np.radians(1.0), None
    for time in times:
        while ping is not None and ping.stamp_ns <= time:
            off = np.abs((angles - ping.angle + np.pi) % (2 * np.pi) - np.pi)
            heard[:, off <= half] = ping.amplitudes[:, None]
            latest_ns = ping.stamp_ns
            ping = next(pings, None)
        yield Frame(jpeg(cv2.resize(fan.draw(heard, white_of(heard)), (WIDTH, WIDTH))), latest_ns)


KIND = Scanner()
