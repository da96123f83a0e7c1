"""A sequence as a Rerun recording: cameras, layers, sonars, path, curves and oysters on the sequence's clock."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from collections.abc import Sequence as Several
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MissingExtraError, OysterbenchError, SequenceError
from oysterbench.core.geometry import Array
from oysterbench.recipe import CLASSES
from oysterbench.report.viewer.estimates import EstimatedPath
from oysterbench.report.viewer.strips import strip_tables
from oysterbench.sensors.camera_messages import LAYERS
from oysterbench.sensors.camera_panels import CLASS_COLOURS, MOVED, UNMOVED, layer_picture
from oysterbench.sensors.panels import QUALITY, Fan, white_of
from oysterbench.sequence.pictures import MEDIA, encoded_pictures
from oysterbench.sequence.types import LIVE, Sequence

CLOCK = "stamp"
"""Timeline of the sequence's stamps. Another, `elapsed`, is the time since the first one."""
ELAPSED = "elapsed"

WORLD, BODY = "world", "world/base_link"
FRUSTUM_M = 0.4  # distance of the image plane drawn in front of a camera
TRUE_COLOUR = (46, 207, 159)
ESTIMATE_COLOURS = ((245, 119, 77), (78, 152, 226), (240, 180, 90), (200, 120, 220), (150, 150, 150))
AXIS_COLOURS = ((78, 152, 226), (245, 119, 77), (46, 207, 159))
LIVE_COLOUR, DEAD_COLOUR = (230, 75, 60), (150, 140, 130)
PATH_RADIUS_M, OYSTER_RADIUS_M = 0.008, 0.03

Progress = Callable[[int, int], None]


def load_rerun() -> Any:
    """Import the module rerun. Raises MissingExtraError where it is not installed."""
    try:
        import rerun
    except ImportError:
        raise MissingExtraError(
            "--rerun needs rerun-sdk, which is not installed; type: pip install 'oysterbench[rerun]'", name="rerun"
        ) from None
    return rerun


def save_recording(
    sequence: Sequence,
    path: Path,
    estimates: Several[EstimatedPath] = (),
    span_ns: tuple[int, int] | None = None,
    progress: Progress = lambda done, total: None,
) -> None:
    """Write a recording (.rrd), with its blueprint, atomically.

    span_ns: first stamp and end (exclusive); all by default. Raises MissingExtraError without rerun-sdk.
    """
    rr = load_rerun()
    with _whole(path) as draft:
        recording = rr.RecordingStream("oysterbench", recording_id=sequence.name)
        recording.save(draft, default_blueprint=blueprint(sequence))
        try:
            Recording(rr, recording, sequence, span_ns, progress).log(estimates)
        finally:
            recording.flush()
            recording.disconnect()


def show_recording(
    sequence: Sequence,
    estimates: Several[EstimatedPath] = (),
    span_ns: tuple[int, int] | None = None,
    progress: Progress = lambda done, total: None,
) -> None:
    """Open Rerun's viewer and send it the same recording. Raises OysterbenchError where there is no display."""
    rr = load_rerun()
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise OysterbenchError(
            f"no display was found to open Rerun on: write a file with --out {sequence.name}.rrd, and open that "
            f"elsewhere with `rerun {sequence.name}.rrd`"
        )
    recording = rr.RecordingStream("oysterbench", recording_id=sequence.name)
    recording.spawn(default_blueprint=blueprint(sequence))
    Recording(rr, recording, sequence, span_ns, progress).log(estimates)
    recording.flush()


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Context with a temporary name to write a file under; the file gets its final name if the block succeeds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.draft")
    try:
        yield draft
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


class Recording:
    """Writer that logs a sequence, part after part. span_ns: first stamp and end (exclusive)."""

    def __init__(
        self, rr: Any, stream: Any, sequence: Sequence, span_ns: tuple[int, int] | None, progress: Progress
    ) -> None:
        self.rr, self.stream, self.sequence, self.progress = rr, stream, sequence, progress
        first = next(iter(sequence.imu()), None)
        if first is None:
            raise SequenceError(f"{sequence.name} has no inertial sample: nothing to show")
        self.origin_ns = first.stamp_ns
        self.start_ns = None if span_ns is None else span_ns[0]
        self.end_ns = None if span_ns is None else span_ns[1]
        self.topics = {topic: count for topic, _, count in sequence.contents()}

    def log(self, estimates: Several[EstimatedPath] = ()) -> None:
        """Log everything, small parts first."""
        parts: list[Callable[[], None]] = [self._still, self._oysters, self._path, self._curves]
        parts += [lambda name=name: self._camera(name) for name in self.sequence.cameras]  # type: ignore[misc]
        parts += [
            lambda name=name, layer=layer: self._layer(name, layer)  # type: ignore[misc]
            for name in self.sequence.cameras
            for layer in LAYERS
            if self.topics.get(f"/{name}/{layer}")
        ]
        parts += [lambda name=name: self._sonar(name) for name in self.sequence.sonars]  # type: ignore[misc]
        for done, part in enumerate(parts):
            self.progress(done, len(parts))
            part()
        for k, estimate in enumerate(estimates):
            self._estimate(estimate, ESTIMATE_COLOURS[k % len(ESTIMATE_COLOURS)])
        self.progress(len(parts), len(parts))

    def _log(self, entity: str, *what: Any, stamp_ns: int | None = None) -> None:
        if stamp_ns is not None:
            self.stream.set_time(CLOCK, timestamp=np.datetime64(stamp_ns, "ns"))
            self.stream.set_time(ELAPSED, duration=np.timedelta64(stamp_ns - self.origin_ns, "ns"))
        self.stream.log(entity, *what, static=stamp_ns is None)

    def _columns(self, entity: str, stamps_ns: NDArray[np.int64], columns: Any) -> None:
        times = [
            self.rr.TimeColumn(CLOCK, timestamp=stamps_ns.astype("datetime64[ns]")),
            self.rr.TimeColumn(ELAPSED, duration=(stamps_ns - self.origin_ns).astype("timedelta64[ns]")),
        ]
        self.rr.send_columns(entity, indexes=times, columns=columns, recording=self.stream)

    def _within(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        if self.start_ns is None or self.end_ns is None:
            return np.ones(len(stamps_ns), dtype=bool)
        return (stamps_ns >= self.start_ns) & (stamps_ns < self.end_ns)

    def _still(self) -> None:
        """Log the static parts: axes, and poses of the sensors. Rerun's pinhole model has no distortion, so that what
        is drawn in 3D from the image of a strongly distorting camera is off by as much."""
        rr, sequence = self.rr, self.sequence
        self._log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for name, camera in sequence.cameras.items():
            place = f"{BODY}/{name}"
            pinhole = rr.Pinhole(
                image_from_camera=camera.matrix,
                resolution=[camera.width, camera.height],
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=FRUSTUM_M,
            )
            self._log(place, self._transform(camera.T_base_cam), pinhole)
            named = [(number, label, CLASS_COLOURS.get(label, (24, 24, 24))) for number, label in CLASSES.items()]
            self._log(f"{place}/class", rr.AnnotationContext(named))
            moves = [(0, "still", (UNMOVED,) * 3), (1, "moves by itself", MOVED)]
            self._log(f"{place}/dynamic", rr.AnnotationContext(moves))
        for name, sonar in sequence.sonars.items():
            self._log(f"{BODY}/{name}", self._transform(sonar.T_base_sensor))

    def _transform(self, T: Array) -> Any:
        return self.rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def _oysters(self) -> None:
        """Log each oyster at its umbo, with its number, state and shell height."""
        try:
            table = self.sequence.oysters()
        except SequenceError:
            return
        heights = table["height_m"] if "height_m" in table else [float("nan")] * len(table)
        labels = [
            f"{number} {state}, {1000 * height:.0f} mm" if np.isfinite(height) else f"{number} {state}"
            for number, state, height in zip(table["id"], table["state"], heights, strict=True)
        ]
        colours = [LIVE_COLOUR if state == LIVE else DEAD_COLOUR for state in table["state"]]
        points = self.rr.Points3D(
            table[["x", "y", "z"]].to_numpy(), radii=OYSTER_RADIUS_M, colors=colours, labels=labels, show_labels=False
        )
        self._log(f"{WORLD}/oysters", points)

    def _path(self) -> None:
        """Log the whole true path, and the body that moves along it."""
        try:
            truth = self.sequence.truth()
        except SequenceError:
            return
        strip = self.rr.LineStrips3D([truth.positions], radii=PATH_RADIUS_M, colors=[TRUE_COLOUR], labels=["truth"])
        self._log(f"{WORLD}/paths/truth", strip)
        kept = self._within(truth.stamps_ns)
        moved = self.rr.Transform3D.columns(translation=truth.positions[kept], quaternion=truth.quaternions[kept])
        self._columns(BODY, truth.stamps_ns[kept], moved)
        self._log(BODY, self.rr.TransformAxes3D(0.3))

    def _estimate(self, estimate: EstimatedPath, colour: tuple[int, int, int]) -> None:
        place = f"{WORLD}/paths/{estimate.name}"
        strip = self.rr.LineStrips3D(
            [estimate.poses.positions], radii=PATH_RADIUS_M, colors=[colour], labels=[estimate.label]
        )
        self._log(place, strip)
        kept = self._within(estimate.poses.stamps_ns)
        at = self.rr.Points3D.columns(positions=estimate.poses.positions[kept])
        self._columns(f"{place}/now", estimate.poses.stamps_ns[kept], at)
        self._log(f"{place}/now", self.rr.Points3D.from_fields(colors=[colour], radii=[4 * PATH_RADIUS_M]))

    def _curves(self) -> None:
        for strip, table in strip_tables(self.sequence):
            kept = table[self._within(table.index.to_numpy())]
            stamps = kept.index.to_numpy(dtype=np.int64)
            for k, column in enumerate(strip.columns):
                entity = curve_entity(strip.title, column if len(strip.columns) > 1 else "")
                name = column.rpartition("_")[2] if len(strip.columns) > 1 else strip.title
                self._log(entity, self.rr.SeriesLines(names=[name], colors=[AXIS_COLOURS[k % 3]]))
                values = kept[column].to_numpy(dtype=float) * strip.factor
                values[~np.isfinite(values)] = np.nan
                self._columns(entity, stamps, self.rr.Scalars.columns(scalars=values))

    def _camera(self, name: str) -> None:
        for picture in encoded_pictures(self.sequence, name, self.start_ns, self.end_ns):
            shown = self.rr.EncodedImage(contents=picture.data, media_type=MEDIA[picture.form])
            self._log(f"{BODY}/{name}/image", shown, stamp_ns=picture.stamp_ns)

    def _layer(self, name: str, layer: str) -> None:
        for image in self.sequence.layer(name, layer, self.start_ns, self.end_ns):
            self._log(f"{BODY}/{name}/{layer}", self._shown(layer, image.pixels), stamp_ns=image.stamp_ns)

    def _shown(self, layer: str, pixels: NDArray[Any]) -> Any:
        """Rerun archetype of a layer: numbers if Rerun has a type for them, else colours as in `oysterbench view`."""
        rr = self.rr
        if layer == "depth":
            return rr.DepthImage(np.rint(1000 * pixels).astype(np.uint16), meter=1000.0)  # in mm, as in the file
        if layer in ("class", "instance", "dynamic"):
            return rr.SegmentationImage(pixels)
        return rr.Image(layer_picture(layer, pixels)).compress(jpeg_quality=QUALITY)

    def _sonar(self, name: str) -> None:
        """Log sonar fans, and ground-truth point clouds if the file has them."""
        rr, calibration = self.rr, self.sequence.sonars[name]
        fan, white = Fan.of(calibration.azimuths_rad, calibration.ranges_m), None
        for ping in self.sequence.sonar(name, self.start_ns, self.end_ns):
            white = white or white_of(ping.pixels)
            picture = np.ascontiguousarray(fan.draw(ping.pixels, white)[..., ::-1])
            self._log(f"sonar/{name}", rr.Image(picture).compress(jpeg_quality=QUALITY), stamp_ns=ping.stamp_ns)
        if not self.topics.get(f"/{name}/cloud"):
            return
        self._log(f"{BODY}/{name}/cloud", rr.AnnotationContext(
            [(number, label, CLASS_COLOURS.get(label, (24, 24, 24))) for number, label in CLASSES.items()]
        ))  # fmt: skip
        for cloud in self.sequence.clouds(name, self.start_ns, self.end_ns):
            points = rr.Points3D(cloud.points, class_ids=cloud.classes, radii=0.01)
            self._log(f"{BODY}/{name}/cloud", points, stamp_ns=cloud.stamp_ns)


def curve_entity(title: str, part: str = "") -> str:
    """Entity path of a curve: `curves/TITLE` without the unit, or below it for one of several curves of a title."""
    words = "_".join(title.partition(",")[0].split())
    return "/".join(["curves", words, *([part] if part else [])])


def blueprint(sequence: Sequence) -> Any:
    """The scene and the sonars on the left; cameras and curves on the right."""
    import rerun.blueprint as rrb

    scene = rrb.Spatial3DView(origin=WORLD, name="path, cameras and oysters")
    sonars = [rrb.Spatial2DView(origin=f"sonar/{name}", name=name) for name in sequence.sonars]
    cameras = [rrb.Spatial2DView(origin=f"{BODY}/{name}", name=name) for name in sequence.cameras]
    curves = [
        rrb.TimeSeriesView(origin=curve_entity(strip.title), name=strip.title) for strip, _ in strip_tables(sequence)
    ]
    left = rrb.Vertical(scene, rrb.Horizontal(*sonars), row_shares=[2, 1]) if sonars else scene
    right = [rrb.Grid(*cameras)] if cameras else []
    right += [rrb.Vertical(*curves[:4]), *([rrb.Tabs(*curves[4:])] if curves[4:] else [])] if curves else []
    body = rrb.Horizontal(left, rrb.Vertical(*right), column_shares=[3, 2]) if right else left
    return rrb.Blueprint(body, rrb.TimePanel(timeline=CLOCK), collapse_panels=True)
