"""The steering track: policies on labelled images against the expert; with --closed-loop, the policies drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.evaluate.steering import EVALUATOR, Commands, failed_metrics, score_pictures
from oysterbench.evaluate.steering.dataset import best_constant
from oysterbench.exploration.labelled_views import LabelledViews, labelled_views
from oysterbench.methods.interfaces import RunSequence
from oysterbench.methods.interfaces.images import LIMIT_OF_PICTURE_S
from oysterbench.methods.interfaces.steering import read_classes, write_views
from oysterbench.methods.outcomes import Job, Outcome
from oysterbench.methods.policy_process import LIMIT_S
from oysterbench.methods.processes import Processes
from oysterbench.recipe import SplitRecipe
from oysterbench.report.exploring import pictures_table, whole_of
from oysterbench.report.steering import PictureRun
from oysterbench.report.steering_figures import picture_figures
from oysterbench.results.records import ResultRecord
from oysterbench.simulation.generate import check_workers, digest
from oysterbench.simulation.salt import salt_for
from oysterbench.tracks.steering_rollouts import REFERENCES, plan_rollouts, run_rollouts, show_rollouts
from oysterbench.tracks.track import (
    Evaluation,
    Option,
    Request,
    Track,
    about_run,
    about_sequence,
    cost_of,
    shown_tables,
)

LOOP_OPTIONS = (
    Option("reefs", "--reefs", "Closed loop: Only the first N reefs.  [default: all]", int),
    Option("seconds", "--seconds", "Closed loop: Length of a rollout, in s.  [default: the split's]", float),
    Option("again", "--again", "Closed loop: Redo the rollouts kept in the folder.", bool),
)


class ViewSequence(RunSequence):
    """A sequence of labelled views of a split."""

    split: SplitRecipe

    def __init__(self, views: LabelledViews, path: Path, split: SplitRecipe) -> None:
        self.name = views.name
        self.views, self.path, self.split = views, path, split

    @property
    def origin(self) -> str:
        """Split, digest of its recipe, and name of the sequence."""
        return f"{self.split.name} {digest(self.split)} {self.name}"

    @property
    def hidden(self) -> tuple[Path, ...]:
        """The sequence file, which holds the labels."""
        return (self.path,)

    @cached_property
    def limit_s(self) -> float:
        """Time limit of a run, s: ten seconds per view, at least ten minutes."""
        return max(LIMIT_OF_PICTURE_S * len(self.views.table), 600.0)

    def write_input(self, form: str, out: Path, processes: Processes) -> None:
        """Write what a policy sees, without the expert's commands."""
        write_views(self.views.views(), self.views.task, out)


class SteeringTrack(Track):
    """Steering track: policies that steer a vehicle exploring a reef."""

    name = "steering"
    title = "Policies that steer a vehicle over a reef, against an expert."
    takes = ("steering",)
    splits = ("steering",)
    default_split = "steer-mini"
    default_methods = ("straight", "chance")
    evaluator = EVALUATOR
    options = (
        Option("closed_loop", "--closed-loop", "Let each --method drive beside the references, or these alone.", bool),
        *LOOP_OPTIONS,
    )
    examples = """
      oysterbench eval steering --method my_policy:MyPolicy --split steer-val
      oysterbench eval steering --closed-loop --method my_policy:MyPolicy --split steer-val --reefs 3"""

    def folder(self, kind: str, options: Mapping[str, Any]) -> str:
        """Name of the results folder; closed-loop results have one of their own."""
        return f"{kind}-closed-loop" if options.get("closed_loop") else super().folder(kind, options)

    def settings(self, options: Mapping[str, Any]) -> None:
        """Return None: the evaluator of this track has no settings."""

    def check(self, request: Request) -> None:
        """Refuse also sequences that belong to no split, since the split defines the commands."""
        if request.split is None:
            raise RecipeError(f"sequences of no split: expected a split of this track, such as {self.default_split}")
        super().check(request)

    def evaluate(self, request: Request) -> Evaluation:
        """Run policies on labelled images, or let them drive."""
        self.check(request)
        if request.options.get("closed_loop"):
            return self._drive(request)
        if given := [option.name for option in LOOP_OPTIONS[:2] if option.key in request.options]:
            raise MethodError(f"{', '.join(given)}: for rollouts only: add --closed-loop")
        if named := [name for name in request.methods if name in REFERENCES]:
            raise MethodError(f"{named[0]!r} sees the ground truth and no images: add --closed-loop")
        return super().evaluate(request)

    def rendered(self, request: Request) -> dict[str, Path]:
        """Files of the requested sequences, in their order, rendered where missing."""
        split = request.split
        assert split is not None
        names = list(request.sequences) or [one.name for one in split.sequence]
        files = super().rendered(replace(request, sequences=names))
        return {name: files[name] for name in names}

    def run_sequences(
        self, split: SplitRecipe | None, files: Mapping[str, Path], options: Mapping[str, Any]
    ) -> Sequence[ViewSequence]:
        """Labelled sequences of a split."""
        assert split is not None
        assert split.steering is not None
        return [ViewSequence(labelled_views(path, split.steering), path, split) for path in files.values()]

    def score(self, job: Job, outcome: Outcome, out: Path, settings: None) -> PictureRun:
        """Score the commands against those of the expert."""
        sequence = job.sequence
        assert isinstance(sequence, ViewSequence)
        views = sequence.views
        about = about_sequence(self.name, sequence.split, views.name, views.digest, {}, EVALUATOR)
        about |= {**about_run(job, outcome), "notes": tuple(outcome.notes)}
        failure = outcome.failure
        if failure is None:
            try:
                commands = Commands(*read_classes(job.folder(out), views.task))
                if len(commands.classes) != len(views.table):
                    raise MethodError(f"expected {len(views.table)} commands, got {len(commands.classes)}")
            except MethodError as error:
                failure = str(error)
        if failure is not None:
            return PictureRun(ResultRecord(**about, failure=failure, metrics=failed_metrics(views.labels)))
        score = score_pictures(views.labels, commands)
        metrics = {**score.metrics, **cost_of(outcome, "pictures_per_s", len(commands.classes))}
        record = ResultRecord(**about, metrics=metrics, reasons=score.reasons)
        return PictureRun(record, views.labels, commands, score)

    def show(self, runs: Sequence[PictureRun], sequences: Sequence[RunSequence], out: Path | None) -> Evaluation:
        """Show the results over all images together, the confusion matrices and sample images."""
        wholes = whole_of(runs)
        views = [one.views for one in sequences if isinstance(one, ViewSequence)]
        figures = picture_figures(views, runs, wholes, out) if out is not None else []
        first = []
        if wholes:
            ran = {run.record.sequence for run in runs}
            constant = best_constant([one.labels for one in views if one.name in ran])
            first.append(pictures_table(wholes, constant, views[0].task))
        return Evaluation(runs, first=first, printed=shown_tables([run.record for run in runs], first), figures=figures)

    def _drive(self, request: Request) -> Evaluation:
        split, options = request.split, request.options
        assert split is not None
        if request.template is not None or request.runs > 1:
            raise MethodError(
                "--closed-loop: expected Python policies, each run once over each reef, which its seed determines"
            )
        policies = [name for name in dict.fromkeys(request.methods) if name not in REFERENCES]
        adapters = self.adapters(replace(request, methods=policies)) if policies else []
        if taken := [one.name for one in adapters if one.name in REFERENCES]:
            raise MethodError(f"{taken[0]!r} is the name of a reference of the closed loop: expected another name")
        self.have_weights(adapters, request)
        reefs = list(request.sequences) or [one.name for one in split.sequence]
        count = options.get("reefs", len(reefs))
        if not 1 <= count <= len(reefs):
            raise RecipeError(f"--reefs: expected at most {len(reefs)}, as many as there are, got {count}")
        salt = salt_for(split.name, split.hidden)
        plan = plan_rollouts(split, options.get("seconds"), salt=salt, limit_s=request.limit_s or LIMIT_S)
        workers = check_workers(request.workers)
        with request.bar(f"driving over {split.name}", "rollouts") as progress:
            runs = run_rollouts(
                plan,
                reefs[:count],
                [*policies, *REFERENCES],
                request.out / "rollouts",
                workers,
                bool(options.get("again")),
                progress,
                request.announce,
            )
        return show_rollouts(runs, request.out)


TRACK = SteeringTrack()
