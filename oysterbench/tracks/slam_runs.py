"""Methods of the SLAM track run over sequences and scored, each as soon as it is finished."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from oysterbench.core.errors import MethodError, SequenceError
from oysterbench.core.files import write_atomically
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.evaluate.slam.scoring import SlamSettings
from oysterbench.methods.entrants import Entrant
from oysterbench.methods.map import MAP
from oysterbench.methods.outcomes import Job, Outcome, alternatives_of, estimate_of
from oysterbench.methods.runner import default_limit_s, run_jobs
from oysterbench.recipe import SplitRecipe
from oysterbench.report import SlamRun
from oysterbench.results.records import hardware
from oysterbench.sequence import open_sequence
from oysterbench.simulation.generate import digest
from oysterbench.tracks.slam import record_outcome, sample_frames

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Dive:
    """A sequence to run on: its name, where it is, and the split that it is of; None for one of the user's own."""

    name: str
    path: Path
    split: SplitRecipe | None = None

    @property
    def origin(self) -> str:
        """What made the sequence: results of another origin are not taken for results on this one."""
        if self.split is not None:
            return f"{self.split.name} {digest(self.split)} {self.name}"
        file = self.path if self.path.is_file() else self.path / "mav0" / "imu0" / "data.csv"
        state = file.stat()
        return f"{file.resolve()} {state.st_size} {state.st_mtime_ns}"

    @cached_property
    def truth(self) -> Trajectory | None:
        """None where the sequence keeps it back."""
        try:
            return open_sequence(self.path).truth()
        except SequenceError:
            return None

    @cached_property
    def frames(self) -> list[tuple[int, bytes]]:
        """For the report."""
        return sample_frames(open_sequence(self.path))


@dataclass(frozen=True)
class Finished:
    """A job that is finished. scored: None where the sequence has no truth."""

    job: Job
    outcome: Outcome
    scored: SlamRun | None

    @property
    def failure(self) -> str | None:
        """Why there is no number, if there is none."""
        return self.outcome.failure if self.scored is None else self.scored.record.failure


def dives_of(paths: Sequence[Path]) -> list[Dive]:
    """Sequences of the user's own: files, or folders in EuRoC layout."""
    dives = [Dive(open_sequence(path).name, path) for path in paths]
    names = [dive.name for dive in dives]
    for name in names:
        if names.count(name) > 1:
            raise MethodError(f"two sequences are named {name!r}: their results would take each other's place")
    return dives


def run_slam(
    dives: Sequence[Dive],
    entrants: Sequence[Entrant],
    settings: SlamSettings,
    out: Path,
    times: int = 1,
    workers: int = 1,
    limit_s: float | None = None,
    again: bool = False,
    retry: bool = False,
    keep_inputs: bool = False,
    announce: Announce = lambda text: None,
) -> Iterator[Finished]:
    """Run each entrant so many times on each sequence, in processes of their own, and score what they leave.

    What `out` holds already is scored and not run (see `runner.run_jobs` for again, retry, keep_inputs). It gets the
    poses as TUM as well: SEQUENCE-truth.tum, SEQUENCE-METHOD.tum, of several runs SEQUENCE-METHOD-RUN.tum; a method's
    other paths as SEQUENCE-METHOD.NAME.tum, and its landmarks as SEQUENCE-METHOD.map.ply.
    """
    known = {dive.name: dive for dive in dives}
    jobs = []
    for dive in dives:
        limit = limit_s or default_limit_s(open_sequence(dive.path).duration_s)
        for entrant in entrants:
            jobs += [Job(entrant, dive.name, dive.path, k, limit, dive.origin) for k in range(times)]
        if dive.truth is not None:
            write_tum(out / f"{dive.name}-truth.tum", dive.truth)
    for job, outcome in run_jobs(jobs, out, workers, again, retry, keep_inputs, hardware(), announce):
        dive = known[job.name]
        estimate = estimate_of(job.folder(out)) if outcome.failure is None else None
        alternatives: dict[str, Trajectory] = {}
        if estimate is not None:
            alternatives = alternatives_of(job.folder(out), outcome)
            number = f"-{job.number + 1}" if times > 1 else ""
            name = f"{job.name}-{job.entrant.name}{number}"
            write_tum(out / f"{name}.tum", estimate)
            for path_name, path in alternatives.items():
                write_tum(out / f"{name}.{path_name}.tum", path)
            if outcome.map is not None:
                write_atomically(out / f"{name}.{MAP}", (job.folder(out) / MAP).read_bytes())
        if dive.truth is None:
            yield Finished(job, outcome, None)
        else:
            record, result = record_outcome(dive.split, dive.truth, job, outcome, estimate, settings, alternatives)
            yield Finished(job, outcome, SlamRun(record, result, dive.frames))
