"""From recipe to sequence files: a list of independent jobs that run anywhere and resume where they were stopped.

A job renders one frame of a camera or one ping of a sonar, or simulates all other sensors, and its bytes are stored as
a part file. Parts are written atomically; when all parts of a sequence exist, they are assembled in time order, and the
sequence file appears in one step. So the bytes depend neither on the number of workers, nor on where they are, nor on
how often the work was interrupted. A part costs some 3 ms beyond its frame, which takes hundreds.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import threading
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

from oysterbench.core.atomic import naming, write_atomically
from oysterbench.core.cluster import Results, run_on_cluster
from oysterbench.core.disk_space import free_bytes
from oysterbench.core.errors import MachineError, OysterbenchError, RecipeError, SequenceError
from oysterbench.core.locks import locked
from oysterbench.core.names import listed
from oysterbench.core.places import home
from oysterbench.recipe import SequenceRecipe, SplitRecipe
from oysterbench.sequence.read import (
    FAULTS,
    FRAMES,
    MOVING,
    MOVING_POSES,
    OYSTERS,
    STEERING,
    McapSequence,
    read_attachments,
    read_messages,
)
from oysterbench.sequence.truth import rig_topics
from oysterbench.sequence.write import pack
from oysterbench.simulation import cost
from oysterbench.simulation.assembly import assemble
from oysterbench.simulation.jobs import Job, bulky_sensors, plan, sources, wanted_topics
from oysterbench.simulation.salt import HOW_TO_MAKE, LEAST_BYTES, Salt, how_to_take_part, is_strong
from oysterbench.simulation.scheduling import run_alone, run_here, run_in_processes
from oysterbench.version import GENERATION, VERSION

WORKER_S = 10.0
"""Rendering that a worker must have to do, s, to be worth its start, which takes some 4 s of processor time."""

PARTS = ".parts"
"""Folder of the parts that are not assembled yet."""

PROGRAM = f"oysterbench {VERSION}, generation {GENERATION}"
"""What determines the bytes besides the recipe: workers elsewhere must have the same."""

Progress = Callable[[int, int], None]
"""Called with the number of frames done, and the total."""


SALTED = 3
"""Generation of what a salt draws, beside GENERATION: raised where only renders with a salt change."""


def digest(split: SplitRecipe, salt: bytes = b"") -> str:
    """SHA-256 of all that determines the bytes: recipe, rig, salt, and the generation of this program."""
    text = f"{GENERATION} {split.digest()} {hashlib.sha256(salt).hexdigest()}"
    if salt:
        text += f" {SALTED}"
    return hashlib.sha256(text.encode()).hexdigest()


def split_folder(split: SplitRecipe, salt: bytes = b"") -> Path:
    """Folder of a split under `OYSTERBENCH_HOME`; another recipe of the same name has another folder."""
    return home() / "splits" / split.name / f"{split.version}-{digest(split, salt)[:12]}"


def sequence_files(split: SplitRecipe, folder: Path) -> dict[str, Path]:
    """Sequence name -> file."""
    return {sequence.name: folder / f"{sequence.name}.mcap" for sequence in split.sequence}


def is_complete(split: SplitRecipe, folder: Path) -> bool:
    """Whether every sequence file of the split exists."""
    return all(path.is_file() for path in sequence_files(split, folder).values())


def generate_split(
    split: SplitRecipe,
    folder: Path,
    workers: int = 1,
    progress: Progress | None = None,
    salt: bytes = b"",
    device: str = "cpu",
    scheduler: str | None = None,
    names: Collection[str] = (),
    before_waiting: Callable[[], None] | None = None,
    topics: Collection[str] = (),
    tell: Callable[[str], None] | None = None,
    taken: Mapping[str, Mapping[str, Path]] | None = None,
) -> dict[str, Path]:
    """Make the missing sequence files of a split (or of these names), and return all of them, by name.

    topics: patterns such as `/imu` or `/cam_front/*`: the files then have no other topics, and only the sensors that
    make these are rendered; all files of a folder have the same topics. workers: processes on this machine, unless the
    address of a Dask `scheduler` is given. device: Warp device on the machines that render. before_waiting: called
    before waiting for another process that renders into the folder. tell: called with a line for the user where parts
    that an earlier call left are damaged; they are made again. taken: sequence -> topic of a camera or sonar -> whole
    file of the same recipe with its messages, which are copied instead of rendered.

    Raises RecipeError where the recipe cannot be built or a hidden split has no sufficient salt, MachineError where the
    disk has too little room, and SequenceError where the folder holds a damaged file or one of another recipe; existing
    files are never overwritten.
    """
    if split.hidden and not is_strong(salt):
        raise RecipeError(
            f"split {split.name} is hidden: it needs a secret salt, of at least {LEAST_BYTES} mixed bytes, "
            f"and got {len(salt)}; {how_to_take_part(split.name)}; to host it: {HOW_TO_MAKE}"
        )
    wanted = [split.find_sequence(name) for name in dict.fromkeys(names)] or split.sequence
    made_by = digest(split, salt)
    files = {sequence.name: sequence_files(split, folder)[sequence.name] for sequence in wanted}
    # Files appear when they are complete: if all wanted ones exist, there is no need to wait for others in progress.
    if all(path.exists() and not _parts(folder, name, made_by).exists() for name, path in files.items()):
        for path in files.values():
            check_made_by(path, split, made_by, topics)
        return files
    with locked(folder / ".lock", before_waiting=before_waiting):
        for name, path in files.items():
            if path.exists():
                check_made_by(path, split, made_by, topics)
                shutil.rmtree(_parts(folder, name, made_by), ignore_errors=True)
        missing = [sequence for sequence in wanted if not files[sequence.name].exists()]
        if missing:
            _check_space(split, missing, folder, made_by, topics)
            task = partial(make_timed_part, split, salt=Salt(salt), device=device, program=PROGRAM)

            elsewhere = scheduler is not None or workers > 1

            def run(jobs: list[Job]) -> Results[Job, Timed]:
                if scheduler is not None:
                    return run_on_cluster(partial(run_alone, task), jobs, scheduler)
                if elsewhere and jobs:
                    return run_in_processes(task, jobs, workers, partial(_warm_up, device))
                return run_here(task, jobs)

            with naming(folder, folder / PARTS):
                _discard_damaged(split, missing, folder, made_by, topics, tell or (lambda line: None))
                count = progress or (lambda done, total: None)
                _render(split, missing, folder, made_by, salt, run, elsewhere, count, topics, taken or {})
        with contextlib.suppress(OSError):  # absent, or holds parts of other recipes
            (folder / PARTS).rmdir()
    return files


def _check_space(
    split: SplitRecipe, sequences: list[SequenceRecipe], folder: Path, made_by: str, topics: Collection[str]
) -> None:
    kept = sum(part.stat().st_size for one in sequences for part in _parts(folder, one.name, made_by).glob("*"))
    needed, free = cost.space(split, sequences, topics) - kept, free_bytes(folder)
    if needed > free:
        raise MachineError(
            f"{folder}: not enough room: rendering needs some {needed / 1e6:.0f} MB, and {free / 1e6:.0f} MB are free; "
            "nothing was rendered: make room, choose fewer with --sequence, or another place with --out or "
            "OYSTERBENCH_HOME"
        )


def check_made_by(path: Path, split: SplitRecipe, made_by: str, topics: Collection[str] = ()) -> None:
    """Raise SequenceError unless a file is of the recipe with this digest and the sequence of its name, and has these
    topics of it, or all."""
    found = McapSequence(path)
    if found.metadata.get("digest") != made_by:
        raise SequenceError(
            f"{path} was made by another recipe of {split.name} (or with another salt, or by another version of "
            "oysterbench); it was left unchanged: delete it or choose another folder with --out"
        )
    if found.name != path.stem:
        raise SequenceError(
            f"{path}: expected the sequence {path.stem}, got {found.name}: probably a copy under a wrong name; it was "
            "left unchanged: delete it or choose another folder with --out"
        )
    wanted, has = set(wanted_topics(split, split.find_sequence(found.name), topics)), set(found.types)
    if has < wanted or (topics and has != wanted):
        raise SequenceError(
            f"{path} has {len(has)} topics, expected {len(wanted)}: it was made with other --topics; it was "
            "left unchanged: delete it or choose another folder with --out"
        )


def share_left(
    split: SplitRecipe,
    sequence: SequenceRecipe,
    folder: Path,
    salt: bytes = b"",
    topics: Collection[str] = (),
    taken: Collection[str] = (),
) -> float:
    """Share, 0 to 1, of a missing sequence that is still to be rendered: an interruption leaves parts behind."""
    there = sum(1 for _ in _parts(folder, sequence.name, digest(split, salt)).glob("*.part"))
    return max(0.0, 1.0 - there / len(plan(split, sequence, topics, taken)))


def _parts(folder: Path, sequence: str, made_by: str) -> Path:
    return folder / PARTS / f"{sequence}-{made_by[:12]}"


def _discard_damaged(
    split: SplitRecipe,
    sequences: list[SequenceRecipe],
    folder: Path,
    made_by: str,
    topics: Collection[str],
    tell: Callable[[str], None],
) -> None:
    """Delete the parts that are truncated or damaged, so that they are made again."""
    for sequence in sequences:
        parts = _parts(folder, sequence.name, made_by)
        found = [parts / job.part for job in plan(split, sequence, topics)]
        bad = [part for part in found if part.is_file() and not is_whole(part)]
        for part in bad:
            part.unlink()
        if bad:
            which = listed(part.name for part in bad)
            tell(f"{parts}: truncated or damaged, rendered again: {which}")


def is_whole(part: Path) -> bool:
    """Whether all that a part, or a sequence file, holds can be read, with the right checksums."""
    try:
        for _ in read_messages(part):
            pass
        dict(read_attachments(part))
    except SequenceError:
        return False
    return True


def _render(
    split: SplitRecipe,
    sequences: list[SequenceRecipe],
    folder: Path,
    made_by: str,
    salt: bytes,
    run: Callable[[list[Job]], Results[Job, Timed]],
    elsewhere: bool,
    progress: Progress,
    topics: Collection[str],
    taken: Mapping[str, Mapping[str, Path]],
) -> None:
    """Run the jobs whose parts are missing; assemble each sequence as soon as its last part is there.

    elsewhere: whether the jobs run in other processes. The next sequence is then rendered meanwhile, since assembling
    one takes minutes where a video link codes frame after frame.
    """
    waiting: dict[str, set[Job]] = {}
    todo: list[Job] = []
    done = total = 0
    for sequence in sequences:
        parts = _parts(folder, sequence.name, made_by)
        jobs = plan(split, sequence, topics, taken.get(sequence.name, ()))
        missing = [job for job in jobs if not (parts / job.part).is_file()]
        waiting[sequence.name] = set(missing)
        todo += missing
        total += sum(job.frames for job in jobs)
        done += sum(job.frames for job in jobs if job not in waiting[sequence.name])
    if total:  # may be 0 for some topics
        progress(done, total)
    stop = threading.Event()
    whole: list[Future[None]] = []

    def put_together(name: str) -> None:
        parts = _parts(folder, name, made_by)
        path, copied = folder / f"{name}.mcap", taken.get(name)
        assemble(split, split.find_sequence(name), parts, path, made_by, salt, topics, copied, stop)
        if not copied:  # what the rest takes is not the cost of the sequence
            cost.keep(folder, name, parts)
        shutil.rmtree(parts, ignore_errors=True)

    def put_together_if_whole(name: str) -> None:
        if not waiting[name]:
            whole.append(assembler.submit(put_together, name))
        for one in whole:
            if one.done() or not elsewhere:
                one.result()  # raises what went wrong there

    with contextlib.ExitStack() as stack:
        assembler = stack.enter_context(ThreadPoolExecutor(1))
        stack.callback(stop.set)  # runs before the assembler is waited for, so an interruption ends it early
        for sequence in sequences:
            put_together_if_whole(sequence.name)
        for job, (part, cpu_s) in stack.enter_context(contextlib.closing(run(todo))):
            parts = _parts(folder, job.sequence, made_by)
            write_atomically(parts / job.part, part)
            cost.add(parts, cpu_s)
            done += job.frames
            if total:
                progress(done, total)
            waiting[job.sequence].discard(job)
            put_together_if_whole(job.sequence)
        for one in whole:
            one.result()


def _warm_up(device: str) -> None:
    """Compile the kernels, which the other processes then find in the cache."""
    from oysterbench.render.camera import warm_up
    from oysterbench.render.device import check_device

    check_device(device)
    warm_up(device)


Timed = tuple[bytes, float]
"""A part, and the processor time, s, that it took, including that of building the sequence in a worker."""


def make_timed_part(split: SplitRecipe, job: Job, salt: bytes, device: str, program: str) -> Timed:
    """Run `make_part`, and measure its processor time."""
    began = time.process_time()
    part = make_part(split, job, salt, device, program)
    return part, time.process_time() - began


def make_part(split: SplitRecipe, job: Job, salt: bytes, device: str, program: str) -> bytes:
    """Do a job, and return the bytes of its part, which are the same wherever the same program does it.

    Raises OysterbenchError where this program differs from `program`.
    """
    if program != PROGRAM:
        raise OysterbenchError(
            f"a worker has {PROGRAM}, and was asked for what {program} makes: install the same version on all workers"
        )
    from oysterbench.render.device import check_device
    from oysterbench.simulation.sensor_simulation import (
        faults_csv,
        frames_csv,
        moving_csvs,
        oyster_csv,
        sensor_messages,
        small_messages,
    )
    from oysterbench.simulation.simulated_sequence import build_sequence

    check_device(device)
    simulated = build_sequence(split, job.sequence, salt, device)
    tables = {}
    if job.source:
        messages = sensor_messages(simulated, bulky_sensors(simulated.rig)[job.source], job.frame, job.frame + 1)
    else:
        messages = small_messages(simulated)
        tables[OYSTERS] = oyster_csv(simulated)
        taken = frames_csv(simulated)
        if taken is not None:
            tables[FRAMES] = taken
        faults = faults_csv(simulated)
        if faults is not None:
            tables[FAULTS] = faults
        if simulated.recipe.life.moves:
            tables[MOVING], tables[MOVING_POSES] = moving_csvs(simulated)
        if split.steering is not None:
            from oysterbench.simulation.steering.labels import steering_csv

            tables[STEERING] = steering_csv(simulated, split.steering)
    kinds = rig_topics(simulated.rig)
    types = {name: kinds[name] for name, source in sources(simulated.rig).items() if source == job.source}
    return pack(messages, types, tables)


def default_workers(cpu_s: float) -> int:
    """Number of workers: at most one per core that this process may use, each with enough to do, and at least one.

    cpu_s: processor time of all that is to be rendered, s.
    """
    return min(check_workers(None), 1 + int(cpu_s / WORKER_S))


def check_workers(workers: int | None) -> int:
    """Number of workers: as requested, or one per core that this process may use. Raises RecipeError below 1."""
    if workers is None:
        return len(os.sched_getaffinity(0))
    if workers < 1:
        raise RecipeError(f"--workers: expected at least 1, got {workers}")
    return workers
