"""The command that makes an oyster map, or a point cloud, of a sequence along a trajectory: parse, call, print."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.evaluate import click_option, given_options
from oysterbench.cli.numbers import Number
from oysterbench.core.errors import OptionError, OysterbenchError

if TYPE_CHECKING:
    from oysterbench.core.trajectory import ReadOptions, Trajectory
    from oysterbench.sequence import Sequence
    from oysterbench.tracks import Option

SOURCES = ("images", "echoes")
DEPTHS = ("stereo", "motion", "plane", "layer")
KINDS = ("auto", "instances", "mask", "probability", "classes")
"""Copy of `annotations.masks.FORMS`, which is slow to load for a page of help."""
TRUTH = "truth"
SETTING_OPTIONS = {
    "far_m": "--far",
    "cell_m": "--cell",
    "voxel_m": "--voxel",
    "threshold": "--threshold",
    "max_gap_s": "--max-gap",
}
"""Key of a setting -> option that sets it."""

Made = TypeVar("Made")

POSITIVE, SHARE = Number(min=0, min_open=True), Number(0, 1, min_open=True, max_open=True)

CLOUD_OPTIONS = {"source": "--from", "voxel_m": "--voxel"}
MAP_OPTIONS = {"depth": "--depth", "kind": "--masks-kind", "cell_m": "--cell", "threshold": "--threshold"}


class MapCommand(click.Command):
    """Command with the options of `eval slam` for reading a trajectory, which are loaded on demand."""

    @cached_property
    def reading(self) -> list[Option]:
        """Options for reading one trajectory, where its content does not determine how."""
        from oysterbench.tracks.slam_options import READING

        return [
            replace(option, help=option.help.replace("Estimate:", "Trajectory:").replace(" (of --truth)", ""))
            for option in READING
            if not option.name.startswith("--truth-") and option.name != "--times"
        ]

    @cached_property
    def _all(self) -> list[click.Parameter]:
        return [*self.params, *map(click_option, self.reading)]

    def get_params(self, context: click.Context) -> list[click.Parameter]:
        """Return the parameters of the command, with the reading options."""
        return [*self._all, *([] if (own := self.get_help_option(context)) is None else [own])]


@click.command(
    "map", cls=MapCommand, short_help="Map oysters per square metre, or a coloured point cloud, along any trajectory."
)
@click.argument("sequence", type=click.Path(path_type=Path))
@click.option(
    "--trajectory",
    type=click.Path(path_type=Path),
    required=True,
    help="Poses of base_link: any trajectory file; 'truth' for the ground truth.",
)
@click.option(
    "--masks", type=click.Path(path_type=Path), help="Oyster masks for its images; 'truth' for the ground truth."
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="With --masks a folder, else a .ply file.")
@click.option("--camera", "cameras", multiple=True, metavar="NAME", help="Camera to use.  [default: the first]")
@click.option("--far", "far_m", type=POSITIVE, help="Maximum range, in m.  [default: map 2.5, cloud 6, echoes any]")
@click.option("--depth", type=click.Choice(DEPTHS), help="Map: source of depths.  [default: stereo, or motion]")
@click.option(
    "--masks-kind", "kind", type=click.Choice(KINDS), help="Map: meaning of the masks' values.  [default: auto]"
)
@click.option("--cell", "cell_m", type=POSITIVE, help="Map: size of the grid cells, in m.  [default: 1]")
@click.option("--threshold", type=SHARE, help="Map: minimum score of an oyster.  [default: 0.5]")
@click.option("--from", "source", type=click.Choice(SOURCES), help="Cloud: source of points.  [default: images]")
@click.option(
    "--voxel", "voxel_m", type=POSITIVE, help="Cloud: voxel size, in m; one point per voxel.  [default: 0.01]"
)
@click.option(
    "--max-gap", "max_gap_s", type=POSITIVE, help="Interpolate poses across at most this many seconds.  [default: 0.3]"
)
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
def map_command(
    sequence: Path,
    trajectory: Path,
    masks: Path | None,
    out: Path,
    cameras: tuple[str, ...],
    far_m: float | None,
    max_gap_s: float | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Map the oysters of a sequence along a trajectory, each counted once. Without --masks, make a point cloud.

    \b
    Examples:
      oysterbench map val-01.mcap --trajectory val-01-gtsam_full.tum --masks masks/ --out map
      oysterbench map val-01.mcap --trajectory poses.tum \\
        --masks instances.json --depth plane --cell 0.5 --out map
      oysterbench map val-01.mcap --trajectory truth \\
        --masks truth --depth layer --out true-map
      oysterbench map mini-01.mcap --trajectory results/mini-01-gtsam_vi.tum --out mini-01.ply
      oysterbench map dive.mcap --trajectory poses.tum --from echoes --voxel 0.05 --out bottom.ply

    The trajectory is refused if gravity as measured by the IMU would not point down along it, as with poses of a camera
    or quaternions with w first. What else in it contradicts the gyroscope or the DVL (its scale, its
    clock, the sense of its rotation) is said on the terminal and on the page of the map.

    \b
    Masks as read by `oysterbench eval --estimate`, named after their images (SEQUENCE/CAMERA/STAMP):
      a folder or .npz   masks, probabilities, classes (each connected part is an oyster; specks are not), or
                         instance numbers
      .json              COCO annotations; categories live and dead, live oyster and dead oyster, or oyster
                         with a `state`, distinguish the two; others are left out, or refused if
                         they may be oysters, such as spat or juvenile oyster

    An image without oysters needs an empty mask, or no annotation: images that are missing are left out.

    \b
    Depths:
      stereo   between two overlapping cameras             motion   between images of one moving camera
      plane    the bottom as a plane, by DVL or altimeter  layer    the ground truth of a rendered sequence

    The folder gets map.html and map.png for viewing, grid.csv, oysters.csv, summary.json, and the rasters mosaic.png
    and density.png with world files, in the trajectory's frame.

    A cloud from images gets its depths from two overlapping cameras or, with one camera, from its frames along the
    path. A cloud from echoes uses DVL, altimeters and imaging sonars, coloured from the images; a sonar fan gives no
    elevation, so its first echo is placed on its lower edge. No cloud uses the ground truth: `export --format ply` does
    that.
    """
    from oysterbench.tracks.slam_options import read_options

    assert isinstance(map_command, MapCommand)
    options = read_options(given_options(map_command.reading, given), sequence, trajectory)[1]
    apart, what = (MAP_OPTIONS, "a map: give --masks") if masks is None else (CLOUD_OPTIONS, "a cloud")
    if names := [option for key, option in apart.items() if given[key] is not None]:
        raise click.UsageError(
            f"{', '.join(names)}: only for {what}{'' if masks is None else ', which is made without --masks'}"
        )
    chosen = {"far_m": far_m, "max_gap_s": max_gap_s}
    chosen |= {key: given[key] for key in (("voxel_m",) if masks is None else ("cell_m", "threshold"))}
    chosen = {key: value for key, value in chosen.items() if value is not None}
    if masks is None:
        facts = _cloud(sequence, trajectory, options, out, given["source"] or "images", cameras, chosen)
        summary = facts.pop("summary")
    else:
        if len(cameras) > 1:
            raise click.UsageError("--camera: a map uses one camera, got several")
        camera = cameras[0] if cameras else None
        facts = _oysters(
            sequence, trajectory, options, masks, out, camera, given["depth"], given["kind"] or "auto", chosen
        )
        summary = facts.pop("summary")
    echo(json.dumps(facts, indent=2) if as_json else summary)


def _settings(kind: Callable[..., Made], chosen: dict[str, Any]) -> Made:
    """Make settings. Raises OptionError with the name of the option whose value is refused."""
    try:
        return kind(**chosen)
    except OysterbenchError as error:
        key, _, rest = str(error).partition(":")
        raise OptionError(f"{SETTING_OPTIONS.get(key, key)}:{rest}") from None


def _is_truth(given: Path) -> bool:
    """Whether an option asks for the ground truth, and not for a file of that name."""
    return str(given) == TRUTH and not given.exists()


def _truth_note(**used: bool) -> tuple[str, ...]:
    """A note on what is from the ground truth, if anything is."""
    true = [what for what, is_true in used.items() if is_true]
    what = f"the true {' and '.join(true)} {'is' if true == ['path'] else 'are'} used"
    return (f"{what}: this map is not an estimate",) if true else ()


def _poses(opened: Sequence, trajectory: Path, options: ReadOptions) -> Trajectory:
    """Read poses from a file, or return the true ones. Raises TrajectoryError where they do not overlap with the
    sequence in time, or are not upright."""
    from oysterbench.core.trajectory import read_trajectory
    from oysterbench.mapping.views import check_time, check_upright

    if _is_truth(trajectory):
        return opened.truth()
    poses = read_trajectory(trajectory, options)
    check_time(opened, poses)
    check_upright(opened, poses)
    return poses


def _cloud(
    sequence: Path,
    trajectory: Path,
    options: ReadOptions,
    out: Path,
    source: str,
    cameras: tuple[str, ...],
    chosen: dict[str, Any],
) -> dict[str, Any]:
    from oysterbench.cli.progress import late_bar
    from oysterbench.sequence import open_sequence

    if out.suffix.lower() != ".ply":
        raise OysterbenchError(f"{out}: expected the name of a .ply file, or --masks and the name of a folder")
    opened = open_sequence(sequence)  # before the slow imports, to refuse it early
    from oysterbench.mapping import CloudSettings, build_cloud
    from oysterbench.mapping.contradictions import contradictions

    if source == "echoes" and "far_m" in chosen:
        chosen = {**chosen, "echo_far_m": chosen["far_m"]}
    settings = _settings(CloudSettings, chosen)
    poses = _poses(opened, trajectory, options)
    for note in _truth_note(path=_is_truth(trajectory)):
        message(note)
    start = time.process_time()
    looks = max(len(cameras), 1)
    if source == "echoes":
        looks += len(opened.altimeters) + len(opened.sonars) + (opened.dvl_calibration is not None)
    with late_bar(f"cloud of {opened.name}", "s of the sequence") as progress:
        watch = _watching(opened, looks, progress)
        cloud = build_cloud(opened, poses, source, cameras, settings, watch)
    if len(cloud) == 0:
        why = "echoes at its poses"
        if source == "images":
            why = (
                "a stereo pair or successive images that overlap, at its poses, nearer than --far; or try --from echoes"
            )
        raise OysterbenchError(f"{opened.name}: no points along {trajectory}; expected {why}; nothing was written")
    cloud.write(out, f"{opened.name} along {trajectory.name}, from {source}, in odom, m")
    for contradiction in contradictions(opened.for_method(), poses):
        message(contradiction)
    facts = {
        "file": str(out),
        "points": len(cloud),
        "source": source,
        "low_m": cloud.points.min(axis=0).round(3).tolist(),
        "high_m": cloud.points.max(axis=0).round(3).tolist(),
        "cpu_s": round(time.process_time() - start, 1),
    }
    sides = " x ".join(f"{high - low:.1f}" for low, high in zip(facts["low_m"], facts["high_m"], strict=True))
    return {**facts, "summary": f"{out}: {len(cloud)} points from {source}, {sides} m"}


def _watching(opened: Sequence, looks: int, progress: Callable[[int, int], None]) -> Callable[[int], None]:
    """Return a function that turns stamps into progress, in seconds of the sequence, over `looks` passes through it."""
    from oysterbench.mapping.views import begin_ns

    first_ns, last_ns, done = begin_ns(opened), 0, 0
    each = max(round(opened.duration_s), 1)

    def watch(stamp_ns: int) -> None:
        nonlocal last_ns, done
        if stamp_ns < last_ns:  # the next pass has started
            done += each
        last_ns = stamp_ns
        progress(min(done + round((stamp_ns - first_ns) * 1e-9), looks * each), looks * each)

    return watch


def _oysters(
    sequence: Path,
    trajectory: Path,
    options: ReadOptions,
    masks: Path,
    out: Path,
    camera: str | None,
    depth: str | None,
    kind: str,
    chosen: dict[str, Any],
) -> dict[str, Any]:
    from oysterbench.cli.progress import LATE_S, late_bars
    from oysterbench.sequence import open_sequence

    if out.suffix.lower() == ".ply":
        raise OysterbenchError(f"{out}: expected the name of a folder for a map, or no --masks for a cloud")
    if out.exists() and not out.is_dir():
        raise OysterbenchError(f"{out}: expected the name of a folder, got a file")
    opened = open_sequence(sequence)  # before the slow imports, to refuse it early
    from oysterbench.mapping import MapSettings, build_map, default_depth, read_seen, true_seen
    from oysterbench.report.density_figure import numbers
    from oysterbench.report.density_files import summary, write_map

    settings = _settings(MapSettings, chosen)
    poses = _poses(opened, trajectory, options)
    first = camera or next(iter(opened.cameras), None)
    if first is None or first not in opened.cameras:
        raise OysterbenchError(
            f"{opened.name} has no camera {first or ''!r}; its cameras: {', '.join(opened.cameras) or 'none'}"
        )
    depth = depth or default_depth(opened, first)
    own = _is_truth(masks)
    true = _truth_note(path=_is_truth(trajectory), masks=own)
    for note in true:
        message(note)
    start = time.process_time()

    def seen() -> Any:
        shown = true_seen(opened, first) if own else read_seen(masks, opened, first, kind, settings.threshold)
        for picture in shown:
            yield picture
            watch(picture.stamp_ns)

    with late_bars(f"map of {opened.name}") as progress:
        watch = _watching(opened, 1, partial(progress, "s of the sequence"))
        found = build_map(opened, poses, seen, first, depth, settings, progress=progress)
    found = replace(found, notes=(*true, *found.notes))
    command = shlex.join(["oysterbench", *sys.argv[1:]])
    if time.process_time() >= start + LATE_S:
        message(f"writing the map of {opened.name}")
    written = write_map(found, out, command)
    for note in found.notes[len(true) :]:
        message(note)
    facts = {**summary(found), "files": [str(path) for path in written]}
    facts["cpu_s"] = round(time.process_time() - start, 1)
    lines = [f"{out}: {written[0].name} and {len(written) - 1} more files"]
    lines += numbers(found.total, found.grid.shares())
    return {**facts, "summary": "\n".join(lines)}
