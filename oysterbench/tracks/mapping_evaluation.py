"""Maps of a sequence along true and estimated paths, each scored against the true map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from oysterbench.core.errors import LabelError, MachineError, MissingExtraError, OysterbenchError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.frames import with_scale
from oysterbench.evaluate.density.scoring import EVALUATOR, Cell, MapCount, TrueCount, score_density
from oysterbench.evaluate.slam.alignment import meet
from oysterbench.evaluate.slam.settings import Align, SlamSettings
from oysterbench.mapping import MapSettings, OysterMap, Seen, build_map, true_seen
from oysterbench.mapping.cover import Cover, tile_of
from oysterbench.mapping.grid import Grid, Oyster, make_grid
from oysterbench.mapping.predicted import true_states
from oysterbench.mapping.projection import Lens, usable
from oysterbench.mapping.survey import raster_of
from oysterbench.mapping.views import PoseInterpolator, shown_at
from oysterbench.recipe import SplitRecipe
from oysterbench.report.density import DensityRun
from oysterbench.results.records import ResultRecord
from oysterbench.sequence import Sequence
from oysterbench.tracks.slam_truth import truth_digest
from oysterbench.tracks.track import Announce, about_sequence

TRUE_POSES = "true poses"
SeenOf = Callable[[], Iterable[Seen]]


@dataclass(frozen=True)
class TrueMap:
    """True map: what is on the ground that a camera saw."""

    count: TrueCount
    oysters: list[Oyster]
    cover: Cover


@dataclass(frozen=True)
class MappedSequence:
    """A sequence to map: with its paths by name (an exception where there is none) and its masks by name (by default
    those of the ground truth). topics: of a file with only some of its split's, which records then name. own_masks:
    the masks are files of the user, rather than a method's."""

    sequence: Sequence
    camera: str
    paths: Mapping[str, Trajectory | Exception]
    masks: Mapping[str, SeenOf] = field(default_factory=dict)
    topics: tuple[str, ...] = ()
    own_masks: bool = False


def camera_with_layers(name: str, cameras: Iterable[str], topics: Collection[str]) -> str:
    """Name of the first camera whose layers depth, class and instance are among the topics of a sequence. Raises
    LabelError where there is none."""
    for camera in cameras:
        if all(f"/{camera}/{layer}" in topics for layer in ("depth", "class", "instance")):
            return camera
    raise LabelError(
        f"{name}: no camera has the layers depth, class and instance, of which the true map is made; its topics: "
        f"{', '.join(sorted(topics))}"
    )


def true_map(sequence: Sequence, camera: str, settings: MapSettings) -> TrueMap:
    """Build the true map from true poses, depths and the table of oysters. It holds the oysters whose centre lies on
    ground that was seen, and those that an image shows whole, as the reef's relief may hide the ground at their centre.

    An oyster counts as shown if at least `least_px` of its pixels in some image are within the usable range of depths.
    """
    truth, calibration = sequence.truth(), sequence.truly_calibrated().cameras[camera]
    poses, lens = PoseInterpolator(truth, settings.max_gap_s), Lens(camera, calibration)
    cover = Cover(raster_of(truth, settings))
    most: Counter[int] = Counter()
    whole: set[int] = set()
    edge = np.ones(lens.shape, dtype=bool)
    edge[settings.border_px : -settings.border_px, settings.border_px : -settings.border_px] = False
    for depth, picture in zip(sequence.layer(camera, "depth"), true_seen(sequence, camera), strict=True):
        frame = shown_at(sequence, camera, depth.stamp_ns)
        T_map_cam = None if frame is None else poses.of_rows(calibration, frame[1])
        if T_map_cam is None:
            continue
        points = lens.points(depth.pixels.astype(float), T_map_cam)
        near = usable(depth.pixels, settings) & np.isfinite(points[..., 0])
        cover.lay(tile_of(cover.raster, points[near], depth.pixels[near]), np.eye(4))
        numbers, pixels = np.unique(picture.numbers[near], return_counts=True)
        for number, count in zip(numbers.tolist(), pixels.tolist(), strict=True):
            most[number] = max(most[number], count)
        enough = set(numbers[pixels >= settings.least_px].tolist())
        whole |= enough.difference(np.unique(picture.numbers[edge | ~near]).tolist())
    table, states = sequence.oysters(), true_states(sequence)
    centres = oyster_centres(table)
    there = cover.holds(centres[:, :2]) | np.isin(table["id"], sorted(whole))
    shown = np.array([most[int(number)] >= settings.least_px for number in table["id"]], dtype=bool)
    oysters = [
        Oyster(centre, states[int(number)], 1)
        for centre, number in zip(centres[there & shown], table["id"][there & shown], strict=True)
    ]
    grid = make_grid(oysters, cover, settings, 0.0)
    live = sum(one.state == "live" for one in oysters)
    count = TrueCount(cells_of(grid), len(oysters), live, int((there & ~shown).sum()), float(grid.area_m2.sum()))
    return TrueMap(count, oysters, cover)


def oyster_centres(table: Any) -> Array:
    """Centres (N, 3) of oysters, m in `map`: half the shell height from the umbo towards the bill (the shell's x)."""
    quaternions = table[["qx", "qy", "qz", "qw"]].to_numpy()
    umbos, heights = table[["x", "y", "z"]].to_numpy(), table["height_m"].to_numpy()
    if len(umbos) == 0:
        return np.zeros((0, 3))
    return np.asarray(
        umbos + 0.5 * heights[:, None] * scipy.spatial.transform.Rotation.from_quat(quaternions).as_matrix()[:, :, 0]
    )


def cells_of(grid: Grid, share: float = 1.0) -> dict[tuple[int, int], Cell]:
    """Cells that were seen enough, by column and row of a grid fixed to the world. share: of live ones among oysters of
    unknown state."""
    live = grid.counts["live"] + share * grid.counts["unknown"]
    west, north = round(grid.west_m / grid.cell_m), round(grid.north_m / grid.cell_m)
    return {
        (west + int(column), north - 1 - int(row)): Cell(float(grid.area_m2[row, column]), float(live[row, column]))
        for row, column in zip(*np.nonzero(grid.known), strict=True)
    }


def aligned(
    truth: Trajectory, estimate: Trajectory, align: Align, max_gap_s: float = SlamSettings.max_gap_s
) -> Trajectory:
    """Align an estimate with the ground truth, as the SLAM track does."""
    fit = meet(truth, estimate, SlamSettings(align=align, max_gap_s=max_gap_s))[1].similarity
    estimate = with_scale(estimate, fit.scale)
    covariances = estimate.covariances
    if covariances is not None and fit.scale != 1.0:
        units = np.array([fit.scale] * 3 + [1.0] * 3)  # of position and attitude
        covariances = covariances * np.outer(units, units)
    return replace(
        estimate,
        positions=fit.apply(estimate.positions),
        quaternions=fit.rotate(estimate.quaternions),
        covariances=covariances,
    )


def evaluate_maps(
    mapped: MappedSequence,
    split: SplitRecipe | None,
    settings: MapSettings,
    depth: str = "layer",
    align: Align = "posyaw",
    announce: Announce = lambda text: None,
) -> Iterator[DensityRun]:
    """Build and score a map for each combination of path and masks; one that fails leaves a record with `failure`.
    Raises LabelError where the user's own masks cannot be read."""
    sequence, camera = mapped.sequence, mapped.camera
    truth = true_map(sequence, camera, settings)
    poses = sequence.truth()
    about = about_sequence(
        "density",
        split,
        sequence.name,
        truth_digest(poses),
        {**settings.as_dict(), "depth": depth, "align": align},
        EVALUATOR,
    )
    if mapped.topics:
        about["info"] = {"topics": list(mapped.topics)}
    masks = mapped.masks or {"": lambda: true_seen(sequence, camera)}
    for path_name, path in {TRUE_POSES: poses, **mapped.paths}.items():
        for mask_name, seen in masks.items():
            method = f"{path_name}, {mask_name}" if mask_name else path_name
            announce(f"mapping {sequence.name} along {method}")
            try:
                if isinstance(path, Exception):
                    raise path
                path_poses = poses if path_name == TRUE_POSES else aligned(poses, path, align, settings.max_gap_s)
                owners: dict[tuple[int, int], int] = {}
                labelled = _owned(sequence, camera, seen, owners)
                found = build_map(sequence, path_poses, labelled, camera, depth, settings, any_length=False)
            except (MachineError, MissingExtraError):
                raise  # no failure of the method: it is not counted, here as elsewhere
            except OysterbenchError as error:
                if mapped.own_masks and isinstance(error, LabelError):
                    raise  # the same along every path, and no failure of any
                yield DensityRun(ResultRecord(**about, method=method, failure=str(error)))
                continue
            score = score_density(truth.count, map_count(found, owners))
            yield DensityRun(
                ResultRecord(
                    **about, method=method, metrics=score.metrics, reasons=score.reasons, notes=found.notes
                ),
                found,
            )  # fmt: skip


def map_count(found: OysterMap, owners: Mapping[tuple[int, int], int]) -> MapCount:
    """What is scored of a map. owners: true oyster, 0 for none, by image index and instance number, of labelled images:
    the others do not tell which oyster is behind an entry."""
    behind = []
    for track in found.tracks:
        pixels: Counter[int] = Counter()
        for patch in track.patches:
            if (patch.frame, patch.number) in owners:
                pixels[owners[patch.frame, patch.number]] += patch.pixels
        behind.append(max(pixels, key=lambda number: (pixels[number], -number), default=0))
    seen = frozenset(
        owners.get((patch.frame, patch.number), 0) for track in found.tracks for patch in track.patches
    ) - {0}
    total = found.total
    known = total.live + total.dead
    # What this evaluator has always taken, also where only dead ones are known: there `grid.live_share` is another.
    share = total.live / known if known > 0 else 1.0
    live = total.live + share * total.unknown
    return MapCount(cells_of(found.grid, share), total.count, live, total.count_low, total.count_high, behind, seen)


def _owned(sequence: Sequence, camera: str, seen: SeenOf, owners: dict[tuple[int, int], int]) -> SeenOf:
    """Wrap `seen` to note in `owners`, on the way, the true oyster that most pixels of each instance belong to."""

    def noted() -> Iterator[Seen]:
        layers = true_seen(sequence, camera)
        layer = next(layers, None)
        for k, picture in enumerate(seen()):
            while layer is not None and layer.stamp_ns < picture.stamp_ns:
                layer = next(layers, None)
            labelled = layer is not None and layer.stamp_ns == picture.stamp_ns
            if layer is not None and labelled and layer.numbers.shape == picture.numbers.shape:
                rows = picture.numbers > 0
                pairs, pixels = np.unique(
                    np.stack([picture.numbers[rows], layer.numbers[rows]]), axis=1, return_counts=True
                )  # fmt: skip
                best: dict[int, tuple[int, int]] = {}
                for number, own, n in zip(*pairs.tolist(), pixels.tolist(), strict=True):
                    best[number] = max(best.get(number, (0, 0)), (n, own))
                owners.update({(k, number): own for number, (_, own) in best.items()})
            yield picture

    return noted
