"""Camera: how its frames and their ground-truth layers are taken, and its calibration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import Image
from oysterbench.core.ros import IMAGE, Message
from oysterbench.recipe import CameraRecipe, SiteRecipe, count
from oysterbench.sensors.camera_errors import camera_errors, with_errors
from oysterbench.sensors.camera_messages import (
    CAMERA_INFO,
    COLOUR,
    LAYERS,
    camera_info,
    camera_topics,
    colour_message,
    layer_message,
    optical_frame,
    read_colour,
)
from oysterbench.sensors.clock import kept
from oysterbench.sensors.exposure import exposures
from oysterbench.sensors.faults import Fault, spans
from oysterbench.sensors.kind import Instants, SensedWorld, SensorKind, topic
from oysterbench.sensors.uncertainty import ErrorModel, Quality

if TYPE_CHECKING:
    from oysterbench.render.camera import Frame
    from oysterbench.render.passage import Passage
    from oysterbench.render.sensor import Exposure
    from oysterbench.sensors.panels import Panel

SIGHT_M, SIGHT_PIECES = 1.5, 12  # length of rays along which the ground truth integrates silt, and samples on each
SILT_STEP_S = 0.25
LEAST_SILT = 0.5  # optical depth from which silt is reported: 0.6 of the direct light is left
FRAME_LAYERS = ("depth", "class", "instance")


LARGEST_PX = 65535
"""Longest edge of an image that JPEG can hold, px."""

DISTORTIONS = {"plumb_bob": (4, 5), "equidistant": (4,)}
"""Distortion model -> numbers of coefficients that it may have."""

LONGEST_OFFSET_S = 2.0**31
"""Greatest offset of a camera's stamps, s: that of a clock from power-on, where another counts from 1970, and more."""

LONGEST_READOUT_S = 1.0
"""Longest readout of a rolling shutter: slow sensors take a tenth of it."""


@dataclass(frozen=True)
class CameraCalibration:
    """A camera: matrix (3, 3) in px, distortion, pose of its optical frame.

    distortion_model and distortion as in sensor_msgs/CameraInfo: plumb_bob (Brown-Conrady k1, k2, p1, p2[, k3]) or
    equidistant (Kannala-Brandt k1 to k4). Behind a flat port, methods are given a lens in water that was fitted to it;
    the true calibration has the lens in air, port_m from the pupil to the port, and port_index, the refractive index of
    water relative to air. The centre of the fitted lens lies behind the pupil, from which depth layers are measured.
    Stamps are late by time_offset_s, with a jitter of time_jitter_s, 1 sigma. readout_s: time in which a rolling
    shutter reads its rows, at an even rate; a stamp is mid-exposure of the middle row.
    """

    width: int
    height: int
    rate_hz: float
    matrix: Array
    distortion: Array
    T_base_cam: Array
    distortion_model: str = "plumb_bob"
    port_m: float | None = None
    port_index: float = 1.0
    time_offset_s: float = 0.0
    time_jitter_s: float = 0.0
    readout_s: float = 0.0

    def taken_ns(self, stamp_ns: int) -> int:
        """Time at which the frame with this stamp was taken, ns, as far as the calibration knows."""
        return stamp_ns - round(1e9 * self.time_offset_s)

    def rows_taken_ns(self, stamp_ns: int) -> NDArray[np.int64]:
        """Times (H,) int64 ns at which the rows of a frame were taken: a rolling shutter reads them one by one."""
        after_s = (np.arange(self.height) - (self.height - 1) / 2) * (self.readout_s / self.height)
        after_ns: NDArray[np.int64] = np.rint(1e9 * after_s).astype(np.int64)
        return self.taken_ns(stamp_ns) + after_ns


@dataclass(frozen=True)
class CameraFrame:
    """A camera's measurement at one instant: colour (H, W, 3) uint8 RGB, the ground-truth layers that go with it, and
    the calibration that methods are given."""

    stamp_ns: int
    camera: str
    colour: NDArray[np.uint8]
    layers: Mapping[str, NDArray[Any]]
    calibration: CameraCalibration


@dataclass(frozen=True)
class Shot:
    """How a frame is taken: T_map_cam and T_map_base (4, 4) at mid-exposure, which is at time_s, the camera's motion
    during the exposure, and the exposure settings."""

    T_map_cam: Array
    T_map_base: Array
    time_s: float
    passage: Passage
    exposure: Exposure


def shot(world: SensedWorld, camera: CameraRecipe, index: int) -> Shot:
    """Return how frame `index` is taken, at index / rate_hz seconds."""
    time_s = index / camera.rate_hz
    exposure = world.renderers[camera.name].exposure
    if camera.auto_exposure:
        exposure = exposures(world, camera).of(index)
    T_map_cam, T_map_base, moved = _passing(world, camera, time_s, exposure.shutter_s)
    return Shot(T_map_cam, T_map_base, time_s, moved, exposure)


def _passing(world: SensedWorld, camera: CameraRecipe, time_s: float, shutter_s: float) -> tuple[Array, Array, Passage]:
    """T_map_cam and T_map_base (4, 4) at a time, and the camera's motion while the shutter is open around that time."""
    from oysterbench.render.passage import passage
    from oysterbench.scene.rig import camera_pose

    mount = camera_pose(camera)
    (body,) = world.bodies(np.array([time_s]))

    def poses(after_s: Array) -> list[Array]:
        return [body @ mount for body in world.bodies(time_s + after_s)]

    return body @ mount, body, passage(camera, shutter_s, poses)


def render_frame(world: SensedWorld, camera: CameraRecipe, index: int) -> Frame:
    """Render frame `index` of a camera."""
    noise = world.streams.generator("camera", camera.name, "noise", index)
    taken = shot(world, camera, index)
    renderer = world.renderers[camera.name]
    return renderer.render(taken.T_map_cam, noise, taken.time_s, taken.T_map_base, taken.passage, taken.exposure)


def render_layers(world: SensedWorld, camera: CameraRecipe, index: int, after: int | None) -> dict[str, NDArray[Any]]:
    """Render those layers of frame `index` that the camera's recipe names and that are not part of a frame itself.

    after: index of the frame to which flow leads; None where there is none, and flow is NaN.
    """
    wanted = [name for name in camera.layers if name not in FRAME_LAYERS]
    if not wanted:
        return {}
    from oysterbench.render.passage import Moment

    taken = shot(world, camera, index)
    next_s = (index if after is None else after) / camera.rate_hz
    following = Moment(next_s, *_passing(world, camera, next_s, 0.0))
    found = world.renderers[camera.name].layers(
        taken.T_map_cam, [*wanted, "instances"], taken.time_s, taken.T_map_base, taken.passage, following
    )
    layers: dict[str, NDArray[Any]] = dict(found)
    if "visibility" in layers:
        layers["visibility"] = layers["visibility"][layers["instances"]]
    if "flow" in layers and after is None:
        layers["flow"] = np.full_like(layers["flow"], np.nan)
    return {name: layers[name] for name in wanted}


def shown(world: SensedWorld, camera: CameraRecipe) -> NDArray[np.int64]:
    """Index (N,) of the frame whose image each frame shows: its own or, where it is a repeat, an earlier one."""
    n = count(world.recipe.duration_s, camera.rate_hz)
    own = np.arange(n)
    if not camera.repeats:
        return own
    repeated = world.streams.generator("camera", camera.name, "repeats").random(n) < camera.repeats
    repeated[0] = False
    return np.asarray(np.maximum.accumulate(np.where(repeated, 0, own)))


class Camera(SensorKind[CameraRecipe, CameraCalibration, Any]):
    """Sensor kind: camera."""

    recipe = CameraRecipe
    calibration = CameraCalibration
    title = "camera"
    reader = "images"
    rank = 70
    pose = "T_base_cam"
    required = True
    bulky = True
    leaves: ClassVar = {"image": COLOUR, "camera_info": CAMERA_INFO}
    truth_leaves: ClassVar = dict.fromkeys(LAYERS, IMAGE)
    read_leaves = ("image",)

    def frame(self, name: str) -> str:
        return optical_frame(name)

    def topics(self, recipe: CameraRecipe) -> dict[str, str]:
        return camera_topics(recipe.name, recipe.sent_layers)

    def calibrate(self, recipe: CameraRecipe, site: SiteRecipe | None) -> dict[str, Any]:
        true = self.true_calibration(recipe, site)
        if recipe.port_mm is None:
            return true
        from oysterbench.sensors.port import WORKING_M, fit_in_water

        fit = fit_in_water(recipe)
        T_base_cam = np.array(true["T_base_cam"])
        T_base_cam[:3, 3] = np.round(T_base_cam[:3, 3] + T_base_cam[:3, 2] * fit.axial_m, 9)
        del true["port"]
        return true | {
            "matrix": fit.matrix.tolist(),
            "distortion_model": "equidistant",
            "distortion": list(fit.distortion),
            "T_base_cam": T_base_cam.tolist(),
            "fitted": {"from_m": WORKING_M[0], "to_m": WORKING_M[1], "rms_px": fit.rms_px, "worst_px": fit.worst_px},
        }

    def true_calibration(self, recipe: CameraRecipe, site: SiteRecipe | None) -> dict[str, Any]:
        from oysterbench.recipe.lens import PORT_INDEX
        from oysterbench.scene.rig import camera_matrix, camera_pose

        entry: dict[str, Any] = {
            "width": recipe.width,
            "height": recipe.height,
            "rate_hz": recipe.rate_hz,
            "matrix": camera_matrix(recipe).tolist(),
            "distortion_model": "equidistant" if recipe.lens == "fisheye" else "plumb_bob",
            "distortion": [*recipe.distortion, *([0.0] * (4 - len(recipe.distortion)))],
            "T_base_cam": camera_pose(recipe).tolist(),
        }
        if recipe.readout_ms:
            entry["readout_s"] = recipe.readout_ms / 1e3
        if recipe.port_mm is not None:
            entry["port"] = {"distance_m": recipe.port_mm / 1e3, "index": PORT_INDEX}
        return entry

    def read_calibration(self, entry: Mapping[str, Any]) -> CameraCalibration:
        port = entry.get("port")
        values = entry if port is None else {**entry, "port_m": port["distance_m"], "port_index": port["index"]}
        found = super().read_calibration(values)
        if not (0 < found.width <= LARGEST_PX and 0 < found.height <= LARGEST_PX):
            raise ValueError(f"expected a width and height of 1 to {LARGEST_PX} px, got {found.width} x {found.height}")
        if found.matrix.shape != (3, 3) or not (found.matrix[0, 0] > 0 and found.matrix[1, 1] > 0):
            raise ValueError("matrix: expected (3, 3) with focal lengths above zero")
        model, shape = found.distortion_model, found.distortion.shape
        if model not in DISTORTIONS:
            raise ValueError(f"distortion_model: expected {' or '.join(DISTORTIONS)}, got {model:.40}")
        if shape not in [(n,) for n in DISTORTIONS[model]]:
            wanted = " or ".join(map(str, DISTORTIONS[model]))
            raise ValueError(
                f"distortion: expected {wanted} coefficients for {model}, got an array {shape}; calibrate with "
                "that model: others, such as the rational one of 8, are not supported"
            )
        if abs(found.time_offset_s) > LONGEST_OFFSET_S:
            raise ValueError(f"expected a time offset of at most {LONGEST_OFFSET_S:g} s, got {found.time_offset_s:g}")
        if not 0 <= found.readout_s <= LONGEST_READOUT_S:
            raise ValueError(f"readout_s: expected 0 to {LONGEST_READOUT_S:g} s, got {found.readout_s:g}")
        return found

    def error_model(self, recipe: CameraRecipe, entry: Mapping[str, Any], quality: Quality) -> ErrorModel:
        return camera_errors(entry, quality)

    def as_given(
        self, recipe: CameraRecipe, entry: Mapping[str, Any], errors: Mapping[str, float], quality: Quality
    ) -> dict[str, Any]:
        given = super().as_given(recipe, entry, errors, quality)
        return given | with_errors(entry, errors) | {"time_offset_s": 0.0, "time_jitter_s": quality.time_jitter_s}

    def as_true(
        self, recipe: CameraRecipe, entry: Mapping[str, Any], errors: Mapping[str, float], quality: Quality
    ) -> dict[str, Any]:
        return {**entry, "time_offset_s": -errors["time_offset_s"], "time_jitter_s": quality.time_jitter_s}

    def measure(self, world: SensedWorld, recipe: CameraRecipe, at: Instants) -> Iterator[CameraFrame]:
        given = self.read_calibration(world.calibration.given[self.key][recipe.name])
        every = round(recipe.rate_hz / recipe.layer_rate_hz) if recipe.layer_rate_hz else 0
        pictures = shown(world, recipe)
        arriving = np.flatnonzero(kept(len(pictures), recipe, world.streams.at("camera", recipe.name)))
        for index in at.wanted.tolist():
            picture = int(pictures[index])
            frame = render_frame(world, recipe, picture)
            layers: dict[str, NDArray[Any]] = {}
            if every and index % every == 0:
                made: dict[str, NDArray[Any]] = {
                    "depth": frame.depth,
                    "class": frame.classes,
                    "instance": frame.instances,
                }
                later = arriving[arriving > index]
                made |= render_layers(world, recipe, picture, int(pictures[later[0]]) if len(later) else None)
                layers = {name: made[name] for name in recipe.layers}
            yield CameraFrame(int(at.stamps_ns[index]), recipe.name, frame.colour, layers, given)

    def faults(self, world: SensedWorld, recipe: CameraRecipe) -> list[Fault]:
        """Spans with silt in front of the camera: its mean optical depth in green over the first SIGHT_M of view."""
        plumes = world.plumes
        if plumes is None:
            return []
        from oysterbench.scene.rig import camera_pose

        mount = camera_pose(recipe)
        times = np.arange(0.0, world.recipe.duration_s, SILT_STEP_S)
        sight = SIGHT_M * (np.arange(SIGHT_PIECES) + 0.5) / SIGHT_PIECES
        half = np.tan(np.radians(recipe.hfov_deg) / 4)
        rays = np.array([[0, 0, 1], [half, 0, 1], [-half, 0, 1], [0, half, 1], [0, -half, 1]])
        points = (rays / np.linalg.norm(rays, axis=1)[:, None])[:, None] * sight[:, None]
        depths = np.zeros(len(times))
        for k, (time_s, body) in enumerate(zip(times.tolist(), world.bodies(times), strict=True)):
            T_map_cam = body @ mount
            seen = plumes.at(time_s).near(T_map_cam[:3, 3], SIGHT_M)
            if len(seen.amount):
                there = points.reshape(-1, 3) @ T_map_cam[:3, :3].T + T_map_cam[:3, 3]
                depths[k] = SIGHT_M * seen.attenuation(there).mean()
        depths = np.round(depths, 4)
        return spans(times, depths >= LEAST_SILT, "silt_optical_depth", depths)

    def encode(self, recipe: CameraRecipe, measurement: CameraFrame) -> list[Message]:
        stamp, name = measurement.stamp_ns, recipe.name
        return [
            camera_info(stamp, name, measurement.calibration),
            colour_message(stamp, name, measurement.colour, recipe.jpeg_quality, self._kept_as(recipe)),
            *(layer_message(stamp, name, layer, pixels) for layer, pixels in measurement.layers.items()),
        ]

    def _kept_as(self, recipe: CameraRecipe) -> str:
        """Image format of single frames: lossless where a video link follows."""
        return "png" if recipe.video_mbit_s else recipe.image_format

    def pass_on(self, recipe: CameraRecipe, name: str, messages: Iterator[Message]) -> Iterator[Message]:
        if not recipe.video_mbit_s or name != topic(recipe.name, "image"):
            yield from messages
            return
        from oysterbench.sensors.video.codec import VideoCodec

        codec = VideoCodec(recipe.height, recipe.width, recipe.rate_hz, recipe.video_mbit_s)
        before, seen = None, None
        for message in messages:
            stamp, pixels = read_colour(message.data)
            if (
                before is None or seen is None or not np.array_equal(pixels, before)
            ):  # else the recorder repeats a frame
                seen = codec.transcode(pixels)
            before = pixels
            yield colour_message(stamp, recipe.name, seen, recipe.jpeg_quality, recipe.image_format)

    def decode(self, name: str, calibration: CameraCalibration, *data: bytes) -> Image:
        stamp, pixels = read_colour(*data)
        height, width = pixels.shape[:2]
        if (width, height) != (calibration.width, calibration.height):
            raise ValueError(
                f"{name}: expected images of {calibration.width} x {calibration.height} px, as its calibration says, "
                f"got {width} x {height}"
            )
        return Image(stamp, name, pixels)

    def panels(self, sequence: Any, name: str) -> list[Panel]:
        from oysterbench.sensors.camera_panels import camera_panels

        return camera_panels(sequence, name)


KIND = Camera()
