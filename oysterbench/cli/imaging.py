"""What `oysterbench eval` does for tracks of images: run methods on a split, or score answers in files."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.outputs import Outputs, end, print_rich
from oysterbench.core.errors import MethodError

if TYPE_CHECKING:
    from oysterbench.report import DatasetRow, ImageRun

TRACKS = ("segmentation", "detection")
DEFAULT_SPLIT = "seg-mini"
DEFAULT_METHODS = ("all", "none", "colour")
FORMS = ("auto", "mask", "probability", "classes")

OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "threshold": ("--threshold", {"type": float, "help": "Images: called oyster from here on.  [default: 0.5]"}),
    "max_detections": ("--max-detections", {"type": int, "help": "Detection: of an image, at most.  [default: 300]"}),
    "form": (
        "--estimate-kind",
        {"type": click.Choice(FORMS), "help": "Images: what the estimate's numbers are.  [default: auto]"},
    ),
    "labels": (
        "--truth-kind",
        {"type": click.Choice(("mask", "classes")), "help": "Images: what the truth's numbers are.  [default: mask]"},
    ),
    "ignore_value": ("--ignore-value", {"type": int, "help": "Images: number in the truth that is not asked about."}),
}
"""Argument -> the option's name, and what click is told of it."""


@dataclass(frozen=True)
class Imaging:
    """The options that were given."""

    given: dict[str, Any]

    def settings(self, track: str) -> Any:
        """Of the track's evaluator."""
        if track == "segmentation":
            from oysterbench.evaluate.segmentation import SegmentationSettings

            if "max_detections" in self.given:
                raise click.UsageError("--max-detections is of the track detection")
            return SegmentationSettings(**self._of("threshold"))
        from oysterbench.evaluate.detection import DetectionSettings

        for key in ("labels", "ignore_value"):
            if key in self.given:
                raise click.UsageError(f"{OPTIONS[key][0]} is of the track segmentation")
        return DetectionSettings(**self._of("threshold", "max_detections"))

    def reading(self) -> dict[str, Any]:
        """How files are read."""
        return self._of("form", "labels", "ignore_value")

    def _of(self, *keys: str) -> dict[str, Any]:
        return {key: self.given[key] for key in keys if key in self.given}

    def refuse(self, keys: Sequence[str], why: str) -> None:
        """Refuse options that do not apply."""
        names = [OPTIONS[key][0] for key in keys if key in self.given]
        if names:
            raise click.UsageError(f"{', '.join(names)}: {why}")


def imaging_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options, and the argument `imaging`."""

    @functools.wraps(command)
    def wrapped(**values: Any) -> Any:
        given = {key: value for key in OPTIONS if (value := values.pop(key)) is not None}
        return command(imaging=Imaging(given), **values)

    for key, (name, about) in reversed(OPTIONS.items()):
        wrapped = click.option(name, key, **about)(wrapped)
    return wrapped


def evaluate_images(
    track: str,
    split_name: str | None,
    method_names: Sequence[str],
    truth: Path | None,
    estimate: Path | None,
    imaging: Imaging,
    out: Path | None,
    workers: int | None,
    outputs: Outputs,
) -> None:
    """Run, score, print, write."""
    settings = imaging.settings(track)
    if truth is not None and estimate is not None:
        from oysterbench.tracks.detection import score_detection_files
        from oysterbench.tracks.segmentation import score_segmentation_files

        score = score_segmentation_files if track == "segmentation" else score_detection_files
        runs, rows = score(truth, estimate, settings, **imaging.reading())
    else:
        imaging.refuse(("form", "labels", "ignore_value"), "says how to read files, but no --truth and --estimate are")
        runs, rows, out = _run(track, split_name, method_names, settings, out, workers)
    _show(runs, rows, out, outputs)


def _run(
    track: str,
    split_name: str | None,
    method_names: Sequence[str],
    settings: Any,
    out: Path | None,
    workers: int | None,
) -> tuple[list[ImageRun], list[DatasetRow], Path]:
    from oysterbench.cli.render import render_files
    from oysterbench.methods import find_method
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import split_folder
    from oysterbench.tracks.detection import evaluate_detection
    from oysterbench.tracks.segmentation import evaluate_segmentation, split_clips

    # Everything that can be wrong with the request is found before the rendering begins.
    split = load_split(split_name or DEFAULT_SPLIT)
    methods = [find_method(name) for name in dict.fromkeys(method_names or DEFAULT_METHODS)]
    for method in methods:
        if method.track not in TRACKS or (track == "segmentation" and method.track != track):
            raise MethodError(f"method {method.name!r} is of the track {method.track!r}; expected one of {track!r}")
    out = out or split_folder(split) / f"results-{track}"
    out.mkdir(parents=True, exist_ok=True)
    clips = split_clips(split, render_files(split, workers=workers))
    evaluate = evaluate_segmentation if track == "segmentation" else evaluate_detection
    runs, rows = evaluate(split, clips, methods, settings, _say)
    return runs, rows, out


def _show(runs: list[ImageRun], rows: list[DatasetRow], out: Path | None, outputs: Outputs) -> None:
    from oysterbench.core.files import write_atomically
    from oysterbench.report import comparison_tables, dataset_tables, images_csv, results_table, terminal_table
    from oysterbench.results.records import document, dump, write_results

    records = [run.record for run in runs]
    data_set = [row.as_plain() for row in rows]
    written = []
    if out is not None:
        write_results(out / "results.json", records, data_set)
        write_atomically(out / "images.csv", images_csv(runs).encode())
        written = [out / "results.json", out / "images.csv"]
    written += outputs.write(runs, out, rows)
    if outputs.as_json:
        click.echo(dump(document(records, data_set)))
    elif not outputs.on_stdout:
        several = len({record.sequence for record in records}) > 1
        shown = [results_table(records)] if several or not rows else []
        tables = [*dataset_tables(rows), *shown, *(comparison_tables(records) if several else [])]
        for table in tables:
            if table.rows:
                print_rich(terminal_table(table))
    end(written, records)


def _say(text: str) -> None:
    click.echo(text, err=True)
