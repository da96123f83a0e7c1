"""Side-scan sonar: fans to port and starboard, narrow along the track, that image the bottom ping by ping."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path as File
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, transform
from oysterbench.core.ros import IMAGE, Message, echo_image, read_echo_image
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import BinnedSonarRecipe
from oysterbench.sensors import acoustics, echoes
from oysterbench.sensors.echoes import Rays
from oysterbench.sensors.faults import Fault
from oysterbench.sensors.interference import Beams, added_power, struck_pings
from oysterbench.sensors.kind import Export, Instants, Row, SensedWorld, SensorKind, link

if TYPE_CHECKING:
    from oysterbench.render.rays import RayCaster
    from oysterbench.sensors.panels import Frame, Panel

SIDES = {"port": 90.0, "starboard": -90.0}
"""Azimuth of each fan's axis, deg to the left of the mount's x."""

COLUMNS, ROWS = 8, 900  # of rays over a fan's main lobe: along the track, and in elevation
STEEPEST_COSINE = 0.05  # least cosine of the elevation in the spread that keeps the beam's width along the track
SMOOTHING_BINS = 9  # window in which the first bottom echo is looked for,
BOTTOM_SHARE = 0.25  # and the share of the ping's median amplitude that it must reach
PANEL_PINGS = 240  # pings that the viewer shows at a time


@dataclass(frozen=True, kw_only=True)
class SidescanRecipe(BinnedSonarRecipe):
    """A side-scan sonar: x of its mount points along the track; two fans look sideways, tilted down."""

    block: ClassVar[str] = "sidescan"

    frequency_khz: float = number(50, 3000, 450.0)
    beam_deg: float = number(0.1, 10, 0.6)  # width of a fan along the track, at half power
    vfov_deg: float = number(5, 90, 50.0)  # width of a fan across the track
    tilt_deg: float = number(0, 80, 30.0)  # of the axes of the fans below the horizon
    bins: int = number(16, 4096, 600)  # bins per side
    max_range_m: float = number(0.5, 200, 15.0)
    bandwidth_khz: float = number(1, 1000, 30.0)
    tvg: bool = field(default=True)


@dataclass(frozen=True)
class SidescanCalibration:
    """A side-scan sonar: slant ranges (bins,) m of each side; widths of a fan along and across the track, and its tilt,
    rad; frequency, Hz; amplitude of one count; pose, x along the track, y to port."""

    ranges_m: Array
    beam_rad: float
    vfov_rad: float
    tilt_rad: float
    frequency_hz: float
    amplitude_step: float
    T_base_sensor: Array


@dataclass(frozen=True)
class SidescanPing:
    """One ping: amplitudes (bins,) uint16 of each side, near to far, in counts of `amplitude_step`."""

    stamp_ns: int
    sensor: str
    port: NDArray[np.uint16]
    starboard: NDArray[np.uint16]

    @property
    def line(self) -> NDArray[np.uint16]:
        """Amplitudes (2 bins,) in the order in which they lie on the bottom, from far port to far starboard."""
        return np.concatenate([self.port[::-1], self.starboard])


class SidescanSonar:
    """A side-scan sonar in a world, over a bottom type of recipe.BOTTOMS.

    Amplitudes are linear; 1 is that of a perfect scatterer (mu = 1, facing the fan) 1 m away that fills a beam, up to
    the slant of high elevations: all are 0.3 dB louder for a fan of 50 degrees, 1 dB for one of 90. Each
    ping is sent and received at the same pose.
    """

    def __init__(self, caster: RayCaster, recipe: SidescanRecipe, site: SiteRecipe, bottom: str = "sand") -> None:
        self.caster = caster
        self.recipe = recipe
        self.site = site
        self._mu = acoustics.backscatter(bottom)
        self._along, self._vertical = float(np.radians(recipe.beam_deg)), float(np.radians(recipe.vfov_deg))
        self._fill = acoustics.aperture(self._along) * acoustics.aperture(self._vertical)
        mount = acoustics.mount_pose(recipe)
        self._mounts = {side: mount @ fan_pose(recipe, side) for side in SIDES}

    @property
    def ranges(self) -> Array:
        """Slant ranges (bins,) m of the bin centres, as the sonar believes them to be."""
        return echoes.bin_middles(self.recipe)

    def ping(self, T_map_base: Array, streams: Streams, index: int, stamp_ns: int = 0) -> SidescanPing:
        """Take ping `index`, with the vehicle at T_map_base (4, 4)."""
        heard = {}
        for side in SIDES:
            branch = streams.at("sidescan", self.recipe.name, index, side)
            power, loss = self.listen(T_map_base, side, branch)
            beams = Beams(T_map_base @ self._mounts[side], np.zeros(1), self._along)
            power = power + added_power(self.recipe, loss, beams, streams, branch)[0]
            heard[side] = echoes.record(power, self.recipe, loss, branch.generator("noise"))
        return SidescanPing(stamp_ns, self.recipe.name, heard["port"], heard["starboard"])

    def listen(self, T_map_base: Array, side: str, streams: Streams) -> tuple[Array, float]:
        """Expected power (bins,) returned to one side, and the absorption in dB/m; `streams` jitters the rays.

        Each ray ends at the first surface that it meets, so whatever lies behind is in its shadow.
        """
        T_map_fan = np.asarray(T_map_base, dtype=float) @ self._mounts[side]
        medium = echoes.Medium.at(self.site, -float(T_map_fan[2, 3]), self.recipe.frequency_khz)
        axis = echoes.range_axis(self.recipe, medium.speed)
        highest = acoustics.first_null(self._vertical)
        edges = echoes.row_edges(self.caster, T_map_fan, axis, np.zeros(1), highest, ROWS)
        rays = self._rays(edges, streams.generator("rays"))
        returns = echoes.send(self.caster, T_map_fan, rays, self._mu, medium.loss, self._fill, axis.reach)
        power = echoes.add_up(axis, rays.columns, 1, returns.nearest, returns.farthest, returns.powers)
        return echoes.resolve(power, axis, medium.speed, self.recipe.bandwidth_khz)[0], medium.loss

    def _rays(self, edges: Array, generator: np.random.Generator) -> Rays:
        """Draw one ray at random in each cell of a grid over the main lobe, rows between elevations `edges`
        (ROWS + 1,) rad.

        The beam of a line array is equally wide along the track at any elevation e: its azimuths are the angles off
        the array's broadside, divided by cos(e).
        """
        widest = acoustics.first_null(self._along)
        width, heights = 2 * widest / COLUMNS, np.diff(edges)
        anywhere = generator.random((2, COLUMNS, ROWS))
        off = width * (np.arange(COLUMNS)[:, None] + anywhere[0]) - widest
        elevations = edges[:-1] + heights * anywhere[1]
        middle_off = np.broadcast_to(width * (np.arange(COLUMNS)[:, None] + 0.5) - widest, off.shape)
        middle_elevations = np.broadcast_to(edges[:-1] + 0.5 * heights, off.shape)
        spread = 1.0 / np.maximum(np.cos(middle_elevations), STEEPEST_COSINE)
        weights = acoustics.beam_pattern(off, self._along) * acoustics.beam_pattern(elevations, self._vertical)
        return Rays(
            azimuths=(off * spread).ravel(),
            elevations=elevations.ravel(),
            middles=np.stack([(middle_off * spread).ravel(), middle_elevations.ravel()]),
            widths=(width * spread).ravel(),
            heights=np.broadcast_to(heights, off.shape).ravel(),
            columns=np.zeros(off.size, dtype=np.int64),
            weights=weights.ravel(),
        )


def fan_pose(recipe: SidescanRecipe, side: str) -> Array:
    """T_mount_fan (4, 4) of the fan on one side: x along its axis, out and down, y along the track."""
    turn = scipy.spatial.transform.Rotation.from_euler("ZY", [SIDES[side], recipe.tilt_deg], degrees=True)
    return transform(turn.as_matrix(), np.zeros(3))


def _of_side(branch: Streams, side: str, index: int) -> Streams:
    return branch.at(index, side)


def first_return(amplitudes: NDArray[np.uint16]) -> int:
    """Bin of the first bottom echo, where the water column ends: the first window of SMOOTHING_BINS whose mean reaches
    BOTTOM_SHARE of the ping's median amplitude; the number of bins where there is none."""
    window = np.ones(SMOOTHING_BINS) / SMOOTHING_BINS
    smooth = np.convolve(amplitudes.astype(float), window, mode="valid")
    strong = smooth >= max(BOTTOM_SHARE * float(np.median(amplitudes)), 1.0)
    return int(np.argmax(strong)) + SMOOTHING_BINS // 2 if strong.any() else len(amplitudes)


def _row(message: Any) -> Row:
    port, starboard = np.split(np.asarray(message.data).view("<u2"), 2)
    sides = {"port": port[::-1], "starboard": starboard}
    first = {f"{side}_first_bin": float(first_return(values)) for side, values in sides.items()}
    return first | {f"{side}_mean": float(values.mean()) for side, values in sides.items()}


def write_waterfall(sequence: Any, name: str, folder: File, truth: bool) -> list[str]:
    """Write NAME.png, 16-bit: one line per ping, the first on top, from far port to far starboard; and NAME.csv: the
    stamp of each line and, with truth, the pose T_map_sensor."""
    calibration = sequence.calibration(name)
    pings = list(sequence.measurements(name))
    lines = np.stack([ping.line for ping in pings]) if pings else np.zeros((1, 2), dtype=np.uint16)
    _, data = cv2.imencode(".png", lines)
    (folder / f"{name}.png").write_bytes(data.tobytes())
    stamps = np.array([ping.stamp_ns for ping in pings], dtype=np.int64)
    rows: list[list[Any]] = [[stamp] for stamp in stamps.tolist()]
    header = ["stamp_ns"]
    if truth and pings:
        path = sequence.truth()
        known = path.at(np.clip(stamps, path.stamps_ns[0], path.stamps_ns[-1]))
        poses = known.matrices @ calibration.T_base_sensor
        quaternions = scipy.spatial.transform.Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
        rows = [[*row, *p, *q] for row, p, q in zip(rows, poses[:, :3, 3].tolist(), quaternions.tolist(), strict=True)]
        header += ["x", "y", "z", "qx", "qy", "qz", "qw"]
    with open(folder / f"{name}.csv", "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
    ranges = calibration.ranges_m
    step_mm = 1e3 * float(ranges[1] - ranges[0])
    return [
        f"{name}.png: {len(pings)} pings, {len(ranges)} bins of {step_mm:.1f} mm to each side from {ranges[0]:.2f} m"
    ]


class Sidescan(SensorKind[SidescanRecipe, SidescanCalibration, SidescanPing]):
    """Sensor kind: side-scan sonar."""

    recipe = SidescanRecipe
    calibration = SidescanCalibration
    title = "side-scan sonar"
    rank = 65
    bulky = True
    leaves: ClassVar = {"ping": IMAGE}
    tables: ClassVar = {"ping": _row}
    exports: ClassVar = {
        "waterfall": Export(
            "side-scan sonars as 16-bit PNG, one line per ping, and CSV with timestamp and pose", write_waterfall
        )
    }

    def calibrate(self, recipe: SidescanRecipe, site: SiteRecipe) -> dict[str, Any]:
        return {
            **echoes.calibrate(recipe),
            "beam_rad": float(np.radians(recipe.beam_deg)),
            "vfov_rad": float(np.radians(recipe.vfov_deg)),
            "tilt_rad": float(np.radians(recipe.tilt_deg)),
            "frequency_hz": 1e3 * recipe.frequency_khz,
        }

    def measure(self, world: SensedWorld, recipe: SidescanRecipe, at: Instants) -> Iterator[SidescanPing]:
        site, bottom = world.recipe.site, world.recipe.reef.bottom
        sonar = world.instrument(recipe, lambda: SidescanSonar(world.caster, recipe, site, bottom))
        return echoes.pings(world, at, sonar.ping)

    def faults(self, world: SensedWorld, recipe: SidescanRecipe) -> list[Fault]:
        """Pulses of other sonars that reach into its beams; value: their azimuth off the axis of each side."""
        branch, beam = world.streams.at("sidescan", recipe.name), float(np.radians(recipe.beam_deg))
        found = []
        for side in SIDES:
            mount = acoustics.mount_pose(recipe) @ fan_pose(recipe, side)
            found += struck_pings(world, recipe, mount, partial(_of_side, branch, side), beam)
        return found

    def encode(self, recipe: SidescanRecipe, measurement: SidescanPing) -> list[Message]:
        """Message with a 16-bit image of one row, from far port to far starboard: one line of a waterfall."""
        stamp, name = measurement.stamp_ns, measurement.sensor
        return [Message(f"/{name}/ping", stamp, echo_image(stamp, link(name), measurement.line[None]))]

    def decode(self, name: str, calibration: SidescanCalibration, *data: bytes) -> SidescanPing:
        stamp, pixels = read_echo_image(data[0], name, (1, 2 * len(calibration.ranges_m)))
        port, starboard = np.split(pixels[0], 2)
        return SidescanPing(stamp, name, np.ascontiguousarray(port[::-1]), starboard)

    def panels(self, sequence: Any, name: str) -> list[Panel]:
        from oysterbench.sensors.panels import WIDTH, Panel

        title = f"{name}, slant range to {sequence.calibration(name).ranges_m[-1]:.1f} m, port on the left"
        frames = partial(_waterfalls, sequence, name)
        return [Panel(title, WIDTH, PANEL_PINGS, frames, WIDTH * PANEL_PINGS // 4)]


def _waterfalls(sequence: Any, name: str, times: NDArray[np.int64]) -> Iterator[Frame]:
    """Yield the last PANEL_PINGS pings at each of the times, the newest on top."""
    from oysterbench.sensors.panels import WIDTH, Frame, blank, coloured, grey_of, jpeg, white_of

    picture = blank(WIDTH, PANEL_PINGS)
    pings = sequence.measurements(name)
    ping = next(pings, None)
    white, latest_ns = None, None
    for time in times:
        while ping is not None and ping.stamp_ns <= time:
            white = white or white_of(ping.line)
            line = cv2.resize(grey_of(ping.line, white)[None], (WIDTH, 1), interpolation=cv2.INTER_AREA)
            picture = np.concatenate([coloured(np.asarray(line)), picture[:-1]])
            latest_ns = ping.stamp_ns
            ping = next(pings, None)
        yield Frame(jpeg(picture), latest_ns)


KIND = Sidescan()
