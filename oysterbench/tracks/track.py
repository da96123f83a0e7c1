"""Base class of tracks: which methods take part, what they are asked for, and how they are run, scored and shown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.sequence import sequences_in
from oysterbench.tracks.downloaded import files_of_split

if TYPE_CHECKING:
    from oysterbench.methods.adapters import MethodAdapter
    from oysterbench.methods.interfaces import RunSequence
    from oysterbench.methods.outcomes import Job, Outcome
    from oysterbench.methods.run_output import OnOutput
    from oysterbench.recipe import SplitRecipe
    from oysterbench.report.cards import Card
    from oysterbench.report.images import DatasetRow
    from oysterbench.report.table import Table
    from oysterbench.results.records import ResultRecord

Announce = Callable[[str], None]
"""Called with a sentence on what is being done."""

Progress = Callable[[int, int], None]
"""Called with the amount done and the total."""


@dataclass(frozen=True)
class Option:
    """An option of a command. key: in the options that a track is given; name: as typed on the command line.

    kind: a type, a tuple of the words to choose from, Path, or a function that parses the text; bool is a flag
    files: whether it concerns reading --truth and --estimate; metavar: name of the value in the help
    """

    key: str
    name: str
    help: str
    kind: Any = str
    multiple: bool = False
    files: bool = False
    metavar: str | None = None


class Run(Protocol):
    """A scored run of a method on a sequence: its record, and a result for figures, None where it failed."""

    @property
    def record(self) -> ResultRecord: ...

    @property
    def result(self) -> Any: ...


@dataclass(frozen=True)
class Kept:
    """A run of an earlier evaluation: its record stays in the tables, but there is no result to draw."""

    record: ResultRecord
    result: None = None


@dataclass(frozen=True)
class Finished:
    """A job that has ended. scored: the scored run, None where the sequence has no ground truth or the machine
    failed."""

    job: Job
    outcome: Outcome
    scored: Any

    @property
    def failure(self) -> str | None:
        """Reason why there is no score; None if there is one."""
        return self.outcome.failure if self.scored is None else self.scored.record.failure


@dataclass(frozen=True)
class Evaluation:
    """Outcome of an evaluation.

    runs: scored runs; data_set: for image tracks, each method over all sequences together; first: tables that precede
    those common to all tracks in files; printed: tables for the terminal; figures: of the report, each with its file;
    files: contents of further files by name; unscored: jobs whose sequence has no ground truth, or where the machine
    failed; earlier: records of jobs that failed in an earlier call, and were not run in this one
    """

    runs: Sequence[Any]
    data_set: Sequence[DatasetRow] = ()
    first: Sequence[Table] = ()
    printed: Sequence[Table] = ()
    figures: Sequence[tuple[Path, Card]] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    unscored: Sequence[Finished] = ()
    earlier: Sequence[ResultRecord] = ()

    @property
    def records(self) -> list[ResultRecord]:
        """Records of all runs."""
        return [run.record for run in self.runs]


Render = Callable[..., dict[str, Path]]
"""Called with a split and options such as the names of sequences and a salt: returns their files by name, rendered
where missing."""

Bar = Callable[[str, str], AbstractContextManager[Progress]]
"""Called with a title and a unit: context in which progress is shown."""


@dataclass(frozen=True)
class Request:
    """Request to evaluate methods: on what, and how.

    split: None for the user's own sequences, `places`; sequences: names of those to use, empty for all; topics:
    patterns of topics in the split's files, empty for all;
    options: of the track, by key; methods: references, empty for the track's defaults; template, name: command line
    and name of an external program instead;
    runs: number per method and sequence; jobs: run at a time, one per core if None; limit_s: time limit of a run;
    again, retry: repeat finished runs, or those without a score; workers: rendering processes; scheduler: address of a
    Dask cluster that runs the methods; exports: folder where inputs of programs are kept for other runs;
    on_output: called every second with the latest output of the runs in progress
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
    on_output: OnOutput | None = None
    bar: Bar = lambda title, unit: nullcontext(lambda done, total: None)
    finished: Callable[[Sequence[Any]], None] = lambda runs: None
    """Called with the runs so far after each of them, so that a kill leaves a table of what was finished."""


class Track(ABC):
    """Base class of a track.

    takes:   tracks whose methods take part, its own first
    splits:  tracks whose splits it is run on
    evaluator: name and version of its evaluator
    files:   what --truth and --estimate are; empty if files cannot be scored
    options: command-line options of its own
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
        """Name of the output folder within the folder of a split; kind: "results" for `eval`, "runs" for `run`."""
        return f"{kind}-{self.name}"

    @abstractmethod
    def settings(self, options: Mapping[str, Any]) -> Any:
        """Settings of its evaluator. Raises OysterbenchError for an invalid value."""

    @abstractmethod
    def run_sequences(
        self, split: SplitRecipe | None, files: Mapping[str, Path], options: Mapping[str, Any]
    ) -> Sequence[RunSequence]:
        """The sequences of a split, or the user's own, as methods are run on them."""

    @abstractmethod
    def score(self, job: Job, outcome: Outcome, out: Path, settings: Any) -> Any:
        """Read and score the predictions of a job, and make its record; None where the sequence has no ground truth."""

    @abstractmethod
    def show(self, runs: Sequence[Any], sequences: Sequence[RunSequence], out: Path | None) -> Evaluation:
        """Make the tables and figures that show runs."""

    def score_files(self, truth: Path, estimate: Path, options: Mapping[str, Any]) -> Evaluation:
        """Score a file or folder of predictions against ground truth. Raises MethodError where the track scores no
        files."""
        raise MethodError(f"the track {self.name} scores no files")

    def with_truth(self, topics: Sequence[str]) -> tuple[str, ...]:
        """Add the topics needed for scoring to patterns of topics. Raises MethodError where all topics are needed."""
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
        """Adapters of the methods to run. Raises MethodError where one cannot be found or is of another track, or where
        two have one name: they would pass for two runs of one method."""
        from oysterbench.methods.adapters import ExternalCommand, PythonMethod, check_distinct
        from oysterbench.methods.systems import split_reference
        from oysterbench.methods.systems.adapter import SystemAdapter

        if request.template is not None:
            return [ExternalCommand(request.template, request.name, self.name, request.poses_of)]
        found: dict[str, MethodAdapter] = {}
        for reference in dict.fromkeys(request.methods or self.default_methods):
            kind = PythonMethod if split_reference(reference) is None else SystemAdapter
            found[reference] = kind(reference, self.takes)
        return check_distinct(found)

    def have_weights(self, adapters: Sequence[MethodAdapter], request: Request) -> None:
        """Fetch trained weights that methods need and that are missing here, if a hub is configured. Raises
        OysterbenchError where they cannot be had."""
        from oysterbench.methods.weights import have_weights

        for adapter in adapters:
            have_weights(adapter.weights, request.announce, request.bar)

    def evaluate(self, request: Request) -> Evaluation:
        """Run methods on sequences, score and show what they predict."""
        # Find everything that can be wrong with the request before rendering starts.
        self.check(request)
        settings = self.settings(request.options)
        adapters = self.adapters(request)
        self.have_weights(adapters, request)
        sequences = self.run_sequences(request.split, self.rendered(request), request.options)
        runs: list[Any] = []
        unscored, earlier = [], []
        for each in self.run(sequences, adapters, settings, request):
            if each.scored is None:
                unscored.append(each)
            else:
                runs.append(each.scored)
                if each.outcome.earlier and each.failure is not None:
                    earlier.append(each.scored.record)
                request.finished(runs)
        places = {sequence.name: i for i, sequence in enumerate(sequences)}
        ranks = {adapter.name: i for i, adapter in enumerate(adapters)}
        # From the order in which they finished to the order in which they were requested.
        runs.sort(key=lambda run: (places[run.record.sequence], ranks[run.record.method], run.record.run))
        found = self.show(runs, sequences, request.out)
        return Evaluation(**{**vars(found), "unscored": unscored, "earlier": earlier})

    def rendered(self, request: Request) -> dict[str, Path]:
        """Files of the split by sequence name, rendered where missing; the user's own by their paths. A hidden split is
        rendered where its salt is set, and is otherwise taken as it was downloaded."""
        from oysterbench.simulation.salt import read_salt

        split = request.split
        if split is None:
            return {str(path): path.absolute() for place in request.places for path in sequences_in(place)}
        salt = read_salt() if split.hidden else b""
        if salt is None:
            return files_of_split(split, request.sequences, request.topics, request.announce)
        names = tuple(request.sequences)
        files = request.render(split, names=names, workers=request.workers, topics=request.topics, salt=salt)
        return {name: path for name, path in files.items() if not request.sequences or name in request.sequences}

    def run(
        self, sequences: Sequence[RunSequence], adapters: Sequence[MethodAdapter], settings: Any, request: Request
    ) -> Iterator[Finished]:
        """Run each method `request.runs` times on each sequence, each run in its own process, and score the
        predictions."""
        from oysterbench.core.hardware import hardware
        from oysterbench.methods.outcomes import Job
        from oysterbench.methods.runner import run_jobs

        jobs = [
            Job(adapter, sequence, k, request.limit_s or sequence.limit_s * adapter.limit_factor, request.runs)
            for sequence in sequences
            for adapter in adapters
            for k in range(request.runs)
        ]
        known: dict[str, Finished] = {}

        def finish(job: Job, outcome: Outcome) -> Finished:
            own = job.adapter.evaluation
            judged = self.settings({**own, **request.options}) if own else settings
            return Finished(job, outcome, self.score(job, outcome, request.out, judged) if outcome.finished else None)

        def failed(job: Job, outcome: Outcome) -> bool:
            found = finish(job, outcome)
            if found.failure is None:
                known[job.title] = found  # not scored once more
            return found.failure is not None

        finished = run_jobs(
            jobs,
            request.out,
            request.jobs,
            request.again,
            failed if request.retry else None,
            request.exports,
            hardware,
            request.announce,
            request.scheduler,
            request.on_output,
        )
        for job, outcome in finished:
            yield known.pop(job.title) if job.title in known else finish(job, outcome)


def check_names_differ(sequences: Sequence[RunSequence]) -> None:
    """Raise MethodError where two of the user's own sequences share a name."""
    names = [sequence.name for sequence in sequences]
    if twice := [name for name in names if names.count(name) > 1]:
        raise MethodError(f"two sequences are named {twice[0]!r}: their results would overwrite each other")


def about_sequence(
    track: str, split: SplitRecipe | None, sequence: str, truth_digest: str, settings: Any, evaluator: str
) -> dict[str, Any]:
    """Fields common to all records of a sequence. settings: of the evaluator, as a mapping"""
    from oysterbench.simulation.conditions import conditions
    from oysterbench.simulation.generate import digest

    return {
        "track": track,
        "split": "" if split is None else split.name,
        "split_digest": "" if split is None else digest(split),
        "hidden": None if split is None else split.hidden,
        "sequence": sequence,
        "truth_digest": truth_digest,
        "conditions": {} if split is None else conditions(split, sequence),
        "settings": settings,
        "evaluator_version": evaluator,
    }


def about_run(job: Job, outcome: Outcome) -> dict[str, Any]:
    """Fields of a record that describe the method and the run."""
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
    """Cost metrics of a run; empty if it never started. rate: key of the metric `amount` per second of wall time, which
    a failed run does not have, since it did not finish"""
    if not outcome.wall_s > 0:
        return {}
    speed = {rate: amount / outcome.wall_s} if outcome.failure is None else {}
    memory = {"peak_memory_mb": outcome.process["peak_bytes"] / 1e6}
    return {"wall_s": outcome.wall_s, "cpu_s": outcome.cpu_s, **speed, **memory}


def shown_tables(records: Sequence[ResultRecord], first: Sequence[Table] = (), runs: bool = False) -> list[Table]:
    """Tables for the terminal: those that a track shows first, results by sequence, and comparisons over several ones;
    what may not be compared, such as paths aligned in different ways, in tables of their own.

    runs: whether to show the spread of runs where there is one sequence
    """
    from oysterbench.report import comparison_tables, results_tables, runs_table
    from oysterbench.results.comparison import boards

    if len({record.sequence for record in records}) > 1:
        more = comparison_tables(records)
    else:
        more = [runs_table(board) for board in boards(records)] if runs else []
    return [*first, *(results_tables(records) if records else []), *more]
