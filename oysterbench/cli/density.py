"""What `oysterbench eval --track density` does: maps along true and estimated paths, scored against the true map."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.map import DEPTHS, KINDS
from oysterbench.cli.outputs import Outputs, end, print_rich
from oysterbench.core.errors import MethodError, TrajectoryError

if TYPE_CHECKING:
    from oysterbench.recipe import SplitRecipe
    from oysterbench.report.density import DensityRun
    from oysterbench.sequence import Sequence as Recorded

TRACK = "density"
DEFAULT_SPLIT = "slam-mini"
DEFAULT_METHODS = ("dead_reckoning",)

OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "poses": (
        "--poses",
        {
            "type": click.Path(path_type=Path, file_okay=False),
            "help": "Density: folder of SEQUENCE-METHOD.tum, as `run` leaves it.",
        },
    ),
    "masks": (
        "--masks",
        {"type": click.Path(path_type=Path), "help": "Density: oysters in the pictures.  [default: true]"},
    ),
    "kind": (
        "--masks-kind",
        {"type": click.Choice(KINDS), "help": "Density: what their numbers are.  [default: auto]"},
    ),
    "depth": ("--depth", {"type": click.Choice(DEPTHS), "help": "Density: where depths come from.  [default: layer]"}),
    "cell_m": ("--cell", {"type": float, "help": "Density: edge of the grid's cells, in m.  [default: 1]"}),
    "sequences": (
        "--sequence",
        {"multiple": True, "metavar": "NAME", "help": "Density, steering: only this one; repeatable."},
    ),
}
"""Argument -> the option's name, and what click is told of it."""


@dataclass(frozen=True)
class Mapping:
    """The options that were given."""

    given: dict[str, Any]

    def refuse(self, besides: Sequence[str] = ()) -> None:
        """Refuse all, but those that the track that was asked for has as well."""
        if names := [OPTIONS[key][0] for key in self.given if key not in besides]:
            raise click.UsageError(f"{', '.join(names)}: of the track density")


def density_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options, and the argument `mapping`."""

    @functools.wraps(command)
    def wrapped(**values: Any) -> Any:
        given = {key: value for key in OPTIONS if (value := values.pop(key)) not in (None, ())}
        return command(mapping=Mapping(given), **values)

    for key, (name, about) in reversed(OPTIONS.items()):
        wrapped = click.option(name, key, **about)(wrapped)
    return wrapped


def evaluate_density(
    split_name: str | None,
    method_names: Sequence[str],
    mapping: Mapping,
    align: str | None,
    out: Path | None,
    workers: int | None,
    outputs: Outputs,
) -> None:
    """Map, score, print, write. Methods of the track SLAM give paths, those of images give masks."""
    from oysterbench.cli.render import render_files
    from oysterbench.mapping import MapSettings
    from oysterbench.methods import find_method
    from oysterbench.recipe import load_split
    from oysterbench.report.density_figure import figure
    from oysterbench.sequence import open_sequence
    from oysterbench.simulation.generate import split_folder
    from oysterbench.tracks.density import Survey, labelled_camera, run_survey

    given = mapping.given
    split = load_split(split_name or DEFAULT_SPLIT)
    settings = MapSettings(**({"cell_m": given["cell_m"]} if "cell_m" in given else {}))
    names = list(dict.fromkeys(method_names or ([] if "poses" in given else DEFAULT_METHODS)))
    tracks = {name: find_method(name).track for name in names}
    if unfit := [name for name, track in tracks.items() if track not in ("slam", "segmentation", "detection")]:
        raise MethodError(
            f"method {unfit[0]!r} gives neither a path nor masks: it is of the track {tracks[unfit[0]]!r}"
        )
    image_methods = [name for name in names if tracks[name] != "slam"]
    if "masks" in given and image_methods:
        raise click.UsageError(f"--masks and --method {image_methods[0]}: expected masks from one of them")
    out = out or split_folder(split) / "results-density"
    out.mkdir(parents=True, exist_ok=True)
    wanted = tuple(given.get("sequences", ()))
    files = render_files(split, workers=workers, names=wanted)
    runs: list[DensityRun] = []
    for name, path in files.items():
        if wanted and name not in wanted:
            continue
        sequence = open_sequence(path)
        camera = labelled_camera(sequence)
        slam_methods = [one for one in names if tracks[one] == "slam"]
        paths = _paths(name, path, split, slam_methods, given.get("poses"), out)
        masks = _masks(sequence, path, camera, image_methods, given.get("masks"), given.get("kind") or "auto", settings)
        survey = Survey(sequence, camera, paths, masks)
        depth, alignment = given.get("depth", "layer"), align or "posyaw"
        for run in run_survey(survey, split, settings, depth, alignment, _say):  # type: ignore[arg-type]
            drawn = "" if run.result is None else figure(run.result).svg()
            runs.append(replace(run, figure=drawn, result=None))
    _show(runs, out, outputs)


def _paths(
    name: str, path: Path, split: SplitRecipe, methods: Sequence[str], folder: Path | None, out: Path
) -> dict[str, Any]:
    """Trajectories by method: those of a folder, and those that methods are run for; the reason where there is none."""
    from oysterbench.core.trajectory import read_trajectory
    from oysterbench.evaluate.slam.scoring import SlamSettings
    from oysterbench.methods.entrants import PythonMethod
    from oysterbench.tracks.density import estimates_in
    from oysterbench.tracks.slam_runs import Dive, run_slam

    found: dict[str, Any] = {}
    if folder is not None:
        kept = estimates_in(folder, name)
        if not kept:
            raise TrajectoryError(f"{folder}: expected estimates of {name}, {name}-METHOD.tum, got none")
        found = {method: read_trajectory(file) for method, file in kept.items()}
    if methods:
        dives = [Dive(name, path, split)]
        entrants = [PythonMethod(one) for one in methods]
        for finished in run_slam(dives, entrants, SlamSettings(), out / "paths", announce=_say):
            method = finished.job.entrant.name
            failed = finished.outcome.failure
            file = out / "paths" / f"{name}-{method}.tum"
            found[method] = read_trajectory(file) if failed is None else MethodError(failed)
    return found


def _masks(
    sequence: Recorded, path: Path, camera: str, methods: Sequence[str], place: Path | None, kind: str, settings: Any
) -> dict[str, Any]:
    """What gives the oysters of pictures, by name; nothing for the truth's own."""
    from oysterbench.mapping import read_seen

    if place is not None:
        return {place.name: lambda: read_seen(place, sequence, camera, kind, settings.threshold)}
    return {name: partial(_answered, path, camera, name, settings.threshold) for name in methods}


def _answered(path: Path, camera: str, name: str, threshold: float) -> Iterator[Any]:
    """The oysters that a method finds in the labelled pictures of a camera."""
    from oysterbench.annotations import labelled_sequence
    from oysterbench.mapping import Seen
    from oysterbench.mapping.predicted import stacked
    from oysterbench.methods import find_method
    from oysterbench.tracks.image_predictions import Cost, answers_of, instances_of

    method: Any = find_method(name)
    clip = labelled_sequence(path)
    for truth, _, answer in answers_of(method, clip, Cost()):
        _, of, stamp = truth.name.rsplit("/", 2)
        if of == camera:
            numbers, scores = stacked(instances_of(answer, name, truth.classes.shape, threshold))
            yield Seen(int(stamp), camera, numbers, scores=scores)


def _show(runs: list[DensityRun], out: Path, outputs: Outputs) -> None:
    from oysterbench.report import comparison_tables, results_table, terminal_table
    from oysterbench.results.records import document, dump, write_results

    records = [run.record for run in runs]
    write_results(out / "results.json", records)
    written = [out / "results.json", *outputs.write(runs, out)]
    if outputs.as_json:
        click.echo(dump(document(records)))
    elif not outputs.on_stdout:
        several = len({record.sequence for record in records}) > 1
        for table in [results_table(records), *(comparison_tables(records) if several else [])]:
            if table.rows:
                print_rich(terminal_table(table))
    end(written, records)


def _say(text: str) -> None:
    click.echo(text, err=True)
