"""Building a map, on which each oyster counts once, from a sequence, a trajectory and the oysters in its images."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import LabelError, SequenceError, TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory
from oysterbench.mapping.association import OysterTracks
from oysterbench.mapping.contradictions import contradictions
from oysterbench.mapping.cover import DIVERGED, Cover, Raster, lattice_around, raster_around, tile_of
from oysterbench.mapping.depth import DEPTHS, SIGMA, depth_source
from oysterbench.mapping.grid import Grid, Oyster, Total, known_states, live_range, live_share, make_grid, total
from oysterbench.mapping.north import magnetic_north
from oysterbench.mapping.pose_graph import Progress, laid
from oysterbench.mapping.predicted import check_shown
from oysterbench.mapping.projection import Lens, Patch, Seen, patches, usable
from oysterbench.mapping.settings import MapSettings
from oysterbench.mapping.tiles import Tiles
from oysterbench.mapping.track import OysterTrack
from oysterbench.mapping.unassociated import UnassociatedCount
from oysterbench.mapping.views import PoseInterpolator, check_time, shown_at
from oysterbench.sequence.types import Sequence

if TYPE_CHECKING:
    import pandas as pd

EXACT_PATH_M = 0.001  # by which a file of the true path may differ from the truth
UNSURE_M = 0.05  # 1 sigma of a path without covariances, between two passes
COARSEST_M = 0.1  # edge of the squares that measure cover, where smaller ones would not fit into memory
CUT_WEIGHT = 0.5  # of the oysters cut by the edge of the area seen, half have their centre inside


@dataclass(frozen=True, repr=False)
class OysterMap:
    """A map of a sequence, in the world frame of its trajectory.

    tracks:  what images show of each oyster
    cover:   the ground that the images show, aligned with their oysters (`mapping.pose_graph`)
    path:    (N, 2) m, where the images were taken, by the trajectory
    images, without_pose, without_depth: number of images given, and of those without a pose or a depth
    unassociated: the count without association (`mapping.unassociated`); None if path and depths are the ground truth
    magnetic_north_rad: clockwise from +y of the path's world frame; None if unknown
    has_magnetometer: whether the sequence has one, which may not show north along this path (`mapping.north`)
    """

    name: str
    camera: str
    depth: str
    oysters: list[Oyster]
    tracks: list[OysterTrack]
    cover: Cover
    path: Array
    settings: MapSettings
    images: int
    without_pose: int = 0
    without_depth: int = 0
    notes: tuple[str, ...] = field(default=())
    unassociated: float | None = None
    magnetic_north_rad: float | None = None
    has_magnetometer: bool = False

    @property
    def depth_sigma(self) -> float:
        """Relative standard deviation of a depth."""
        return sigma_of(self.depth, self.settings)

    @cached_property
    def grid(self) -> Grid:
        """Grid of oysters per square metre."""
        return make_grid(self.oysters, self.cover, self.settings, self.depth_sigma, self.unassociated)

    @cached_property
    def total(self) -> Total:
        """Totals of the area seen."""
        return total(self.oysters, self.grid, self.depth_sigma, len(self.path), self.unassociated)

    def table(self) -> pd.DataFrame:
        """Table with a row for each oyster: x_m, y_m, z_m in the world frame of the trajectory; state (live, dead or
        unknown); views, number of images that show it; weight, what it counts, 1/2 if no image shows it whole."""
        import pandas as pd

        rows = [(*map(float, one.centre), one.state, one.views, one.weight) for one in self.oysters]
        return pd.DataFrame(rows, columns=["x_m", "y_m", "z_m", "state", "views", "weight"])

    def __repr__(self) -> str:
        return f"<OysterMap of {self.name}: {self._outline}>"

    def _repr_html_(self) -> str:
        from oysterbench.core.display import CardTable, card

        found = self.total
        rows = [
            ("oysters", f"{found.count:.0f}", f"{found.count_low:.0f} to {found.count_high:.0f}"),
            (
                "live per m²" if found.told else "live or dead, per m²",
                f"{found.live_per_m2:.1f}",
                f"{found.low_per_m2:.1f} to {found.high_per_m2:.1f}" + ("" if found.of_reef else ", seen ground alone"),
            ),
        ]
        lead = f"{self._outline}; depths: {self.depth}"
        return card(f"Oysters of {self.name}", lead, [CardTable(("", "found", "95 % interval"), rows)], (), self.notes)

    @property
    def _outline(self) -> str:
        found = self.total
        return f"{found.count:.0f} oysters on {found.area_m2:.1f} m², {found.live:.0f} live, {found.dead:.0f} dead"


def build_map(
    sequence: Sequence,
    trajectory: Trajectory,
    seen: Callable[[], Iterable[Seen]],
    camera: str,
    depth: str,
    settings: MapSettings | None = None,
    progress: Progress = lambda what, done, total: None,
    any_length: bool = True,
) -> OysterMap:
    """Build the map. trajectory: poses of base_link at any stamps; seen: returns the oysters of images, in time order.

    depth: one of `depth.DEPTHS`; only "layer" uses ground truth, for depths and for the camera's calibration.
    progress: called with the progress once all images have been read. any_length: where what is seen along the whole
    trajectory does not fit into memory, map around the images alone, in larger squares than `raster_m` if need be;
    otherwise refuse it. What may be wrong without being an error is in the map's notes. Raises TrajectoryError where
    the trajectory does not overlap with the sequence in time, LabelError where the oysters are not of images of this
    camera, SequenceError where there is no depth.
    """
    settings = settings or MapSettings()
    if camera not in sequence.cameras:
        raise SequenceError(f"{sequence.name} has no camera {camera!r}; its cameras: {', '.join(sequence.cameras)}")
    source = sequence.truly_calibrated() if depth == "layer" else sequence.for_method()
    calibration = source.cameras[camera]
    lens = Lens(camera, calibration)
    poses = PoseInterpolator(trajectory, settings.max_gap_s)
    check_time(sequence, trajectory)
    depth_of = depth_source(depth, source, camera, lens, poses, settings)
    exact = _exact(sequence, trajectory, depth, settings)
    if not any_length:
        raster_of(trajectory, settings)
    lattice = lattice_around(*_around(trajectory.positions, settings))
    pictures = list[list[Patch]]()
    places, counts = [], {"images": 0, "without_pose": 0, "without_depth": 0}
    any_oyster, in_gaps = False, 0
    with Tiles() as tiles:
        for k, picture in enumerate(seen()):
            counts["images"] += 1
            shown = shown_at(sequence, camera, picture.stamp_ns)
            check_shown(picture, sequence, camera, shown is not None)
            assert shown is not None
            any_oyster |= bool(picture.numbers.any())
            image, first_ns = shown
            T, T_world_cam = (find(calibration, first_ns) for find in (poses.taking, poses.of_rows))
            if T is None or T_world_cam is None:
                counts["without_pose"] += 1
                in_gaps += poses.is_gap(calibration.taken_ns(first_ns))
                continue
            depth_m = depth_of(picture.stamp_ns, first_ns)
            if depth_m is None:
                counts["without_depth"] += 1
                continue
            points = lens.points(depth_m, T_world_cam)
            depth_m = np.where(np.isfinite(points[..., 0]), depth_m, np.nan)
            near = usable(depth_m, settings)
            tiles.add(tile_of(lattice, points[near], depth_m[near], image.pixels[near]))
            eye = (T @ calibration.T_base_cam)[:3, 3]
            sigma = _pose_sigma(trajectory, picture.stamp_ns, settings, exact), sigma_of(depth, settings)
            pictures.append(patches(k, picture, points, depth_m, eye, lens.pixel_sr, *sigma, settings))
            places.append(T[:3, 3])
            _check_extent(places, settings)
        _check(sequence, camera, depth, counts, len(places), _reasons(counts, in_gaps, settings))
        path = np.array(places)
        pictures, moves = laid(pictures, path, settings, progress)
        raster = _raster(trajectory, path if any_length else None, tiles.rasters, moves, settings)
        cover, unassociated = _ground(raster, tiles, moves, pictures)
    notes = _notes(sequence, camera, depth, counts, _reasons(counts, in_gaps, settings), any_oyster)
    if cover.raster.edge_m > 1.5 * lattice.edge_m:
        notes.append(
            f"the ground is measured in squares of {100 * cover.raster.edge_m:.2g} cm instead of "
            f"{100 * lattice.edge_m:.2g} cm, as the images lie far apart"
        )
    notes += contradictions(source, trajectory)
    tracks = OysterTracks(settings)
    for k, found in enumerate(pictures, start=1):
        tracks.add(found)
        progress("images counted", k, len(pictures))
    joined = tracks.joined()
    oysters = [_oyster(track) for track in joined]
    notes += _note_on_states(oysters)
    return OysterMap(
        sequence.name, camera, depth, oysters, joined, cover, path[:, :2], settings,
        **counts,
        notes=tuple(notes),
        unassociated=None if exact else unassociated.count,
        magnetic_north_rad=magnetic_north(source, poses),
        has_magnetometer=source.magnetometer_calibration is not None,
    )  # fmt: skip


def _raster(
    trajectory: Trajectory, path: Array | None, tiles: list[Raster], moves: Array, settings: MapSettings
) -> Raster:
    """Raster that holds tiles after their moves (N, 4, 4): along the whole trajectory or, where that does not fit into
    memory, around the images' positions (N, 3) alone, if given, in larger squares if need be. Raises TrajectoryError
    where these do not fit either."""
    choices = [(trajectory.positions, settings.raster_m)]
    far_apart = DIVERGED
    if path is not None:
        choices += [(path, edge_m) for edge_m in _edges(settings)]
        far_apart = _far_apart(path, settings)
    for places, edge_m in choices:
        try:
            around = raster_around(*_around(places, settings, edge_m), far_apart)
            return around.holding(zip(tiles, moves, strict=True), settings.cell_m, far_apart)
        except TrajectoryError as error:
            refused = error
    raise refused


def _ground(
    raster: Raster, tiles: Tiles, moves: Array, pictures: Iterable[list[Patch]]
) -> tuple[Cover, UnassociatedCount]:
    """Cover of the ground, and count without association, after the images' moves (N, 4, 4)."""
    cover = Cover(raster)
    unassociated = UnassociatedCount(cover.raster)
    for tile, move, found in zip(tiles, moves, pictures, strict=True):
        unassociated.add(cover.lay(tile, move), found)
    return cover, unassociated


def _exact(sequence: Sequence, trajectory: Trajectory, depth: str, settings: MapSettings) -> bool:
    """Whether positions are certain enough to tell shells apart: true depths along the true path, attitudes included,
    also between its poses, where images are placed.

    The error of any other path between two passes over the same ground is unknown: covariances are only claims. If
    depths are measured, the ground truth is not consulted.
    """
    if depth != "layer" or sigma_of(depth, settings) * settings.far_m >= settings.shell_m:
        return False
    if not sequence.has_truth:
        return False
    truth = sequence.truth()
    stamps = np.union1d(trajectory.stamps_ns, truth.stamps_ns)
    for path in (trajectory, truth):
        stamps = stamps[(stamps >= path.stamps_ns[0]) & (stamps <= path.stamps_ns[-1])]
    given, true = trajectory.at(stamps), truth.at(stamps)
    turns = (Rotation.from_quat(true.quaternions).inv() * Rotation.from_quat(given.quaternions)).magnitude()
    near = np.abs(given.positions - true.positions) <= EXACT_PATH_M
    return bool(len(stamps) and near.all() and (turns * settings.far_m <= EXACT_PATH_M).all())


def sigma_of(depth: str, settings: MapSettings) -> float:
    """Relative standard deviation of a depth from a source."""
    return SIGMA[depth] if settings.depth_sigma is None else settings.depth_sigma


def _oyster(track: OysterTrack) -> Oyster:
    weight = 1.0 if track.whole else CUT_WEIGHT
    return Oyster(track.centre, track.state, len(track.frames), weight, track.doubt, track.score)


def raster_of(trajectory: Trajectory, settings: MapSettings) -> Raster:
    """Raster of what can be seen along a trajectory. Raises TrajectoryError like `raster_around`."""
    return raster_around(*_around(trajectory.positions, settings))


def _around(places: Array, settings: MapSettings, edge_m: float | None = None) -> tuple[Array, float, float, float]:
    """Arguments for a raster around places (N, 3) m, of `raster_m` or another edge."""
    edge = settings.cell_m / round(settings.cell_m / (edge_m or settings.raster_m))  # a whole number in a cell's edge
    # What is seen lies within the maximum depth, and a little farther at the image corners.
    return places[:, :2], 1.5 * settings.far_m, edge, settings.cell_m


def _edges(settings: MapSettings) -> list[float]:
    """Edges of squares, m, from `raster_m` to COARSEST_M, of which at least 5 make the edge of a cell."""
    edges = [settings.raster_m]
    while 2 * edges[-1] <= min(COARSEST_M, settings.cell_m / 5):
        edges.append(2 * edges[-1])
    return edges


def _check_extent(places: list[Array], settings: MapSettings) -> None:
    """Raise TrajectoryError where images lie farther apart than any raster can hold."""
    if len(places) % 100 == 1:
        path = np.array(places)
        raster_around(*_around(path, settings, _edges(settings)[-1]), _far_apart(path, settings))


def _far_apart(path: Array, settings: MapSettings) -> str:
    """What to say where images at positions (N, 3) m lie too far apart: that larger cells, which may consist of larger
    squares, would do where they would."""
    larger = replace(settings, cell_m=max(settings.cell_m, 5 * COARSEST_M))
    if len(_edges(larger)) == len(_edges(settings)):
        return DIVERGED
    try:
        raster_around(*_around(path, larger, _edges(larger)[-1]))
    except TrajectoryError:
        return DIVERGED
    return f"larger cells can be made of larger squares: --cell {larger.cell_m:g} maps it"


def _pose_sigma(trajectory: Trajectory, stamp_ns: int, settings: MapSettings, exact: bool) -> float:
    """1 sigma of the position of a pose, m: from its covariance, but at least that of the settings."""
    least = settings.pose_sigma_m
    if trajectory.covariances is None:
        return least if least is not None else 0.0 if exact else UNSURE_M
    k = int(np.abs(trajectory.stamps_ns - stamp_ns).argmin())
    return max(least or 0.0, float(np.sqrt(np.trace(trajectory.covariances[k][:3, :3]) / 3.0)))


def _reasons(counts: dict[str, int], in_gaps: int, settings: MapSettings) -> str:
    """Why images have no pose, in words."""
    outside = counts["without_pose"] - in_gaps
    between = f"{in_gaps} between poses more than {settings.max_gap_s:g} s apart (--max-gap, max_gap_s, allows more)"
    return ", ".join([*([between] if in_gaps else []), *([f"{outside} before or after the path"] if outside else [])])


def _notes(
    sequence: Sequence, camera: str, depth: str, counts: dict[str, int], reasons: str, any_oyster: bool
) -> list[str]:
    """What readers of a map should know about its input, in sentences."""
    notes, given = [], counts["images"]
    if depth == "layer":
        notes.append("depths come from the ground truth (layer depth), which no real survey has")
    if not any_oyster:
        notes.append(
            f"no oyster in any of {given} masks: if there are oysters, the threshold or the meaning of the masks' "
            "values is wrong (--threshold, --masks-kind)"
        )
    unmasked = _unmasked(sequence, camera, given)
    if unmasked:
        notes.append(
            f"{unmasked} have no mask and are left out; an image without oysters needs an empty mask for its ground to "
            "count as seen"
        )
    if counts["without_pose"]:
        notes.append(f"{counts['without_pose']} of {given} images have no pose and are left out: {reasons}")
    if counts["without_depth"]:
        notes.append(f"{counts['without_depth']} of {given} images have no depth and are left out")
    return notes


def _note_on_states(oysters: list[Oyster]) -> list[str]:
    """What readers should know of the states of oysters, where some are known and others are not."""
    unknown = sum(one.state == "unknown" for one in oysters)
    live, dead = known_states(oysters)
    if unknown == 0 or live + dead == 0:
        return []
    low, high = live_range(oysters)
    why = "as of the known ones"
    if live == 0 or dead == 0:
        why = f"as all the known ones are {'dead' if live == 0 else 'live'}, which says nothing of the others"
    return [
        f"{unknown} of {len(oysters)} oysters are of unknown state and count as {100 * live_share(oysters):.0f} % live "
        f"(95 %: {100 * low:.0f} to {100 * high:.0f} %), {why}"
    ]


def _unmasked(sequence: Sequence, camera: str, given: int) -> str:
    """How many images of a camera have no mask, if `given` have one, in words; empty for none. Of a rendered sequence,
    usually only the labelled images have masks, so these are expected unless more are given."""
    counts = {name: count for name, _, count in sequence.contents()}
    labelled = counts.get(f"/{camera}/class", 0)
    kind, expected = "labelled images", labelled
    if given > labelled:
        kind, expected = "images", counts.get(f"/{camera}/image", counts.get(camera, 0))  # a topic; a folder of EuRoC
    return f"{expected - given} of {expected} {kind}" if given < expected else ""


def _check(sequence: Sequence, camera: str, depth: str, counts: dict[str, int], used: int, reasons: str) -> None:
    if counts["images"] == 0:
        raise LabelError(f"{sequence.name}: no mask of an image of {camera}: expected some to map")
    if counts["without_pose"] == counts["images"]:
        raise TrajectoryError(
            f"{sequence.name}: the trajectory has no pose at any of {counts['images']} images that have masks: "
            f"{reasons}"
        )
    if used == 0:
        others = ", ".join(source for source in DEPTHS if source != depth)
        raise SequenceError(
            f"{sequence.name}: none of {counts['images']} images has a depth from {depth!r}; expected another --depth: "
            f"{others}"
        )
