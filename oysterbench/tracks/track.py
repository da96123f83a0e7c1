"""What a track is: who takes part, what is asked for, and how predictions are run, read, scored, recorded and shown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.sequence import sequences_in

if TYPE_CHECKING:
    from oysterbench.methods.adapters import MethodAdapter
    from oysterbench.methods.hearing import Told
    from oysterbench.methods.interfaces import RunSequence
    from oysterbench.methods.outcomes import Job, Outcome
    from oysterbench.recipe import SplitRecipe
    from oysterbench.report.cards import Card
    from oysterbench.report.images import DatasetRow
    from oysterbench.report.table import Table
    from oysterbench.results.records import ResultRecord

Announce = Callable[[str], None]
"""Called with a sentence on what is being done."""

Progress = Callable[[int, int], None]
"""Called with what is done and what there is to do."""


@dataclass(frozen=True)
class Option:
    """An option of a command. key: in the options that a track is given; name: as it is typed.

    kind: a type, a tuple of the words to choose from, Path, or what makes the value of the text; bool is a flag
    files: whether it says how --truth and --estimate are read; metavar: of the value, in the help
    """

    key: str
    name: str
    help: str
    kind: Any = str
    multiple: bool = False
    files: bool = False
    metavar: str | None = None


class Run(Protocol):
    """A run of a method on a sequence, scored: its record, and what there is to draw, None where it failed."""

    @property
    def record(self) -> ResultRecord: ...

    @property
    def result(self) -> Any: ...


@dataclass(frozen=True)
class Kept:
    """A run of an earlier evaluation: its record stays in the tables, and there is nothing left to draw."""

    record: ResultRecord
    result: None = None


@dataclass(frozen=True)
class Finished:
    """A job that has ended. scored: None where the sequence has no truth, or the machine failed."""

    job: Job
    outcome: Outcome
    scored: Any

    @property
    def failure(self) -> str | None:
        """Why there is no number, if there is none."""
        return self.outcome.failure if self.scored is None else self.scored.record.failure


@dataclass(frozen=True)
class Evaluation:
    """What an evaluation found.

    runs: scored; data_set: of tracks of images, each method over all sequences together; first: tables that stand
    before those of every track in files; printed: those of the terminal; figures: of the report, each with its file;
    files: further ones by name; unscored: jobs whose sequence has no truth, or where the machine failed
    """

    runs: Sequence[Any]
    data_set: Sequence[DatasetRow] = ()
    first: Sequence[Table] = ()
    printed: Sequence[Table] = ()
    figures: Sequence[tuple[Path, Card]] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    unscored: Sequence[Finished] = ()

    @property
    def records(self) -> list[ResultRecord]:
        """Of all runs."""
        return [run.record for run in self.runs]


Render = Callable[..., dict[str, Path]]
"""Called with a split and (names, salt) of its sequences: their files, rendered where they are not there."""

Bar = Callable[[str, str], AbstractContextManager[Progress]]
"""Called with a title and a unit: shows progress."""


@dataclass(frozen=True)
class Request:
    """What is to be evaluated, and how.

    split: None for the user's own sequences, `places`; sequences: names of those that are taken, none for all; topics:
    of the split's files, by patterns, none for all;
    options: of the track, by key; methods: references, none for the track's own; template, name: of a program instead;
    runs: of each method on each sequence; jobs: at a time, one for each core where it is None; limit_s: of a run;
    again, retry: run what is finished, or failed, once more; workers: processes that render; scheduler: address of a
    Dask cluster that runs the methods; exports: folder where what programs are given is kept for other runs;
    told: called every second with what the runs that go on said last
    """

    out: Path
    split: SplitRecipe | None = None
    places: Sequence[Path] = ()
    sequences: Sequence[str] = ()
    topics: tuple[str, ...] = ()
    methods: Sequence[str] = ()
    template: str | None = None
    name: str = ""
    poses_of: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    runs: int = 1
    jobs: int | None = None
    workers: int | None = None
    limit_s: float | None = None
    again: bool = False
    retry: bool = False
    exports: Path | None = None
    scheduler: str | None = None
    render: Render = lambda split, **options: {}
    announce: Announce = lambda text: None
    told: Told | None = None
    bar: Bar = lambda title, unit: nullcontext(lambda done, total: None)
    finished: Callable[[Sequence[Any]], None] = lambda runs: None
    """Called with the runs so far after each of them, so that a kill leaves a table of what was finished."""


class Track(ABC):
    """A track.

    takes:   tracks of the methods that take part, its own first
    splits:  tracks of the splits that it is run on
    evaluator: name and version of what scores it
    files:   what --truth and --estimate are; empty where no files can be scored
    options: of its own
    """

    name: str
    title: str
    takes: tuple[str, ...]
    splits: tuple[str, ...]
    default_split: str
    default_methods: tuple[str, ...]
    evaluator: str
    files: str = ""
    options: tuple[Option, ...] = ()
    examples: str = ""

    def folder(self, kind: str, options: Mapping[str, Any]) -> str:
        """Name under the folder of a split of what there is of a kind: "results" of `eval`, "runs" of `run`."""
        return f"{kind}-{self.name}"

    @abstractmethod
    def settings(self, options: Mapping[str, Any]) -> Any:
        """Of its evaluator. Raises OysterbenchError for a value that it does not take."""

    @abstractmethod
    def run_sequences(
        self, split: SplitRecipe | None, files: Mapping[str, Path], options: Mapping[str, Any]
    ) -> Sequence[RunSequence]:
        """The sequences of a split, or the user's own, as methods are run on them."""

    @abstractmethod
    def score(self, job: Job, outcome: Outcome, out: Path, settings: Any) -> Any:
        """Read and score what a job left, and make its record; None where the sequence has no truth."""

    @abstractmethod
    def show(self, runs: Sequence[Any], sequences: Sequence[RunSequence], out: Path | None) -> Evaluation:
        """Runs with the tables and figures that show them."""

    def score_files(self, truth: Path, estimate: Path, options: Mapping[str, Any]) -> Evaluation:
        """Score a file, or a folder of them, against another."""
        raise MethodError(f"the track {self.name} scores no files")

    def with_truth(self, topics: Sequence[str]) -> tuple[str, ...]:
        """Patterns of topics, and of those that runs on them are scored by. Raises MethodError where all are needed."""
        raise MethodError(f"--topics is for methods of the track slam: {self.name} needs complete sequences")

    def check(self, request: Request) -> None:
        """Refuse what cannot be evaluated, before anything is rendered. Raises OysterbenchError."""
        split = request.split
        if split is None:
            return
        if split.track not in self.splits:
            raise RecipeError(
                f"split {split.name} is of the track {split.track}, but {self.name} runs on splits of "
                f"{' or '.join(self.splits)}, such as {self.default_split}; `oysterbench splits` lists what there is"
            )
        for name in request.sequences:
            split.find_sequence(name)

    def adapters(self, request: Request) -> list[MethodAdapter]:
        """What is run. Raises MethodError where it cannot be found, or is of another track."""
        from oysterbench.methods.adapters import ExternalCommand, PythonMethod
        from oysterbench.methods.systems import split_reference
        from oysterbench.methods.systems.adapter import SystemAdapter

        if request.template is not None:
            return [ExternalCommand(request.template, request.name, self.name, request.poses_of)]
        names = dict.fromkeys(request.methods or self.default_methods)
        return [
            PythonMethod(name, self.takes) if split_reference(name) is None else SystemAdapter(name, self.takes)
            for name in names
        ]

    def have_weights(self, adapters: Sequence[MethodAdapter], request: Request) -> None:
        """Fetch trained weights that methods run on and that are not here, where a hub is set. Raises OysterbenchError
        where they cannot be had."""
        from oysterbench.methods.weights import have_weights

        for adapter in adapters:
            have_weights(adapter.weights, request.announce, request.bar)

    def evaluate(self, request: Request) -> Evaluation:
        """Run methods on sequences, score and show what they predict."""
        # Everything that can be wrong with the request is found before the rendering begins.
        self.check(request)
        settings = self.settings(request.options)
        adapters = self.adapters(request)
        self.have_weights(adapters, request)
        sequences = self.run_sequences(request.split, self.rendered(request), request.options)
        runs: list[Any] = []
        unscored = []
        for each in self.run(sequences, adapters, settings, request):
            if each.scored is None:
                unscored.append(each)
            else:
                runs.append(each.scored)
                request.finished(runs)
        places = {sequence.name: i for i, sequence in enumerate(sequences)}
        ranks = {adapter.name: i for i, adapter in enumerate(adapters)}
        # From the order in which they were finished to that in which they were asked for.
        runs.sort(key=lambda run: (places[run.record.sequence], ranks[run.record.method], run.record.run))
        found = self.show(runs, sequences, request.out)
        return Evaluation(**{**vars(found), "unscored": unscored})

    def rendered(self, request: Request) -> dict[str, Path]:
        """Files by the names of their sequences; the user's own by theirs."""
        if request.split is None:
            return {str(path): path.absolute() for place in request.places for path in sequences_in(place)}
        files = request.render(
            request.split, names=tuple(request.sequences), workers=request.workers, topics=request.topics
        )
        return {name: path for name, path in files.items() if not request.sequences or name in request.sequences}

    def run(
        self, sequences: Sequence[RunSequence], adapters: Sequence[MethodAdapter], settings: Any, request: Request
    ) -> Iterator[Finished]:
        """Run each method so many times on each sequence, in processes of their own, and score what they leave."""
        from oysterbench.methods.outcomes import Job
        from oysterbench.methods.runner import run_jobs
        from oysterbench.results.records import hardware

        jobs = [
            Job(adapter, sequence, k, request.limit_s or sequence.limit_s * adapter.limit_factor, request.runs)
            for sequence in sequences
            for adapter in adapters
            for k in range(request.runs)
        ]
        finished = run_jobs(
            jobs,
            request.out,
            request.jobs,
            request.again,
            request.retry,
            request.exports,
            hardware,
            request.announce,
            request.scheduler,
            request.told,
        )
        for job, outcome in finished:
            own = job.adapter.evaluation
            judged = self.settings({**own, **request.options}) if own else settings
            yield Finished(job, outcome, self.score(job, outcome, request.out, judged) if outcome.finished else None)


def about_sequence(
    track: str, split: SplitRecipe | None, sequence: str, truth_digest: str, settings: Any, evaluator: str
) -> dict[str, Any]:
    """What every record of a sequence says. settings: of the evaluator, as a mapping"""
    from oysterbench.simulation.conditions import conditions
    from oysterbench.simulation.generate import digest

    return {
        "track": track,
        "split": "" if split is None else split.name,
        "split_digest": "" if split is None else digest(split),
        "sequence": sequence,
        "truth_digest": truth_digest,
        "conditions": {} if split is None else conditions(split, sequence),
        "settings": settings,
        "evaluator_version": evaluator,
    }


def about_run(job: Job, outcome: Outcome) -> dict[str, Any]:
    """What every record of a run says of the method and of the run."""
    about = {"method": dict(job.adapter.about)} if job.adapter.about else {}
    keys = ("command", "versions", "limit_s", "process", "started", "contained")
    return {
        "method": job.adapter.name,
        "method_settings": job.adapter.settings,
        "run": job.number,
        "seed": outcome.identity["seed"],
        "hardware": outcome.hardware,
        "created": outcome.ended,
        "info": {**outcome.info, **about, "run": {key: getattr(outcome, key) for key in keys}},
    }


def cost_of(outcome: Outcome, rate: str, amount: float) -> dict[str, float]:
    """What a run cost; nothing where it did not begin. rate: metric of `amount` per second of wall time, which a failed
    run has not: it did not get through"""
    if not outcome.wall_s > 0:
        return {}
    speed = {rate: amount / outcome.wall_s} if outcome.failure is None else {}
    memory = {"peak_memory_mb": outcome.process["peak_bytes"] / 1e6}
    return {"wall_s": outcome.wall_s, "cpu_s": outcome.cpu_s, **speed, **memory}


def shown_tables(records: Sequence[ResultRecord], first: Sequence[Table] = (), runs: bool = False) -> list[Table]:
    """The tables of the terminal: what a track shows first, results by sequence, and comparisons over several ones.

    runs: show how runs spread where there is one sequence
    """
    from oysterbench.report import comparison_tables, results_table, runs_table
    from oysterbench.results.comparison import boards

    if len({record.sequence for record in records}) > 1:
        more = comparison_tables(records)
    else:
        more = [runs_table(board) for board in boards(records)] if runs else []
    return [*first, *([results_table(records)] if records else []), *more]
