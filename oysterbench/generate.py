"""Recipe to sequence files: a list of independent jobs, run by processes, resumed where they were stopped.

A job renders a few frames of one camera, or simulates the other sensors, into a part file. A part is there whole or
not at all; when all parts of a sequence are there, they are put together in time order, and the sequence appears in
one step. So the bytes depend neither on the number of workers nor on how often the work was interrupted.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.errors import OysterbenchError, RecipeError, SequenceError
from oysterbench.files import home, locked, write_atomically
from oysterbench.geometry import Array
from oysterbench.recipe import CLASSES, RigRecipe, SequenceRecipe, SplitRecipe, count
from oysterbench.sequence import topics
from oysterbench.sequence.read import CALIBRATION, METADATA, OYSTERS, McapSequence, read_attachments, read_messages
from oysterbench.sequence.topics import EPOCH_NS, Message
from oysterbench.sequence.write import SequenceWriter, pack
from oysterbench.version import VERSION

GENERATION = 3
"""Raised whenever the same recipe begins to give other bytes, so that no cached file is taken for a new one."""

FRAMES_PER_PART = 10
"""What a kill can cost: a few seconds of work per worker."""

Progress = Callable[[int, int], None]
"""Called with the frames done and the frames wanted."""


@dataclass(frozen=True)
class Job:
    """Frames or pings [first, last) of a camera or sonar, by its name; or, without one, all the small sensors."""

    sequence: str
    source: str = ""
    first: int = 0
    last: int = 0

    @property
    def part(self) -> str:
        """Name of the file that the job leaves."""
        return f"{self.source}-{self.first:06d}-{self.last:06d}.part" if self.source else "sensors.part"


def digest(split: SplitRecipe, salt: bytes = b"") -> str:
    """SHA-256 of all that decides the bytes: recipe, rig, salt, and the generation of this program."""
    text = f"{GENERATION} {split.digest()} {hashlib.sha256(salt).hexdigest()}"
    return hashlib.sha256(text.encode()).hexdigest()


def split_folder(split: SplitRecipe, salt: bytes = b"") -> Path:
    """Where a split is kept under `OYSTERBENCH_HOME`; another recipe under the same name has another folder."""
    return home() / "splits" / split.name / f"{split.version}-{digest(split, salt)[:12]}"


def sequence_files(split: SplitRecipe, folder: Path) -> dict[str, Path]:
    """Sequence name -> file."""
    return {sequence.name: folder / f"{sequence.name}.mcap" for sequence in split.sequence}


def is_complete(split: SplitRecipe, folder: Path) -> bool:
    """Whether every sequence file of the split is there."""
    return all(path.is_file() for path in sequence_files(split, folder).values())


def generate_split(
    split: SplitRecipe, folder: Path, workers: int = 1, progress: Progress | None = None, salt: bytes = b""
) -> dict[str, Path]:
    """Make the sequence files of a split that are not there yet, and return all of them.

    Raises RecipeError where the recipe cannot be built, and SequenceError where the folder holds a damaged file or
    one of another recipe; nothing that is there is overwritten.
    """
    files = sequence_files(split, folder)
    with locked(folder / ".lock"):
        for name, path in files.items():
            if path.exists():
                _check_made_by(path, split, salt)
                shutil.rmtree(_parts(folder, name, split, salt), ignore_errors=True)
        missing = [sequence for sequence in split.sequence if not files[sequence.name].exists()]
        if missing:
            _render(split, missing, folder, workers, progress or (lambda done, total: None), salt)
        with contextlib.suppress(OSError):  # absent, or with parts of other recipes in it
            (folder / ".parts").rmdir()
    return files


def _check_made_by(path: Path, split: SplitRecipe, salt: bytes) -> None:
    made_by = McapSequence(path).metadata.get("digest")
    if made_by != digest(split, salt):
        raise SequenceError(
            f"{path} was made by another recipe of {split.name} (or another version of oysterbench); it was left as it "
            "is: delete it or choose another folder with --out"
        )


def _parts(folder: Path, sequence: str, split: SplitRecipe, salt: bytes) -> Path:
    return folder / ".parts" / f"{sequence}-{digest(split, salt)[:12]}"


def plan(split: SplitRecipe, sequence: SequenceRecipe) -> list[Job]:
    """All jobs of a sequence."""
    jobs = [Job(sequence.name)]
    rates = {camera.name: camera.rate_hz for camera in split.rig.camera}
    rates |= {sonar.name: sonar.rate_hz for sonar in split.rig.sonar}
    for source, rate_hz in rates.items():
        frames = count(sequence.duration_s, rate_hz)
        for first in range(0, frames, FRAMES_PER_PART):
            jobs.append(Job(sequence.name, source, first, min(first + FRAMES_PER_PART, frames)))
    return jobs


def _render(
    split: SplitRecipe,
    sequences: list[SequenceRecipe],
    folder: Path,
    workers: int,
    progress: Progress,
    salt: bytes,
) -> None:
    """Run the jobs that have left no part yet; put each sequence together as soon as its last part is there."""
    waiting: dict[str, set[Job]] = {}
    todo: list[Job] = []
    done = total = 0
    for sequence in sequences:
        parts = _parts(folder, sequence.name, split, salt)
        jobs = plan(split, sequence)
        missing = [job for job in jobs if not (parts / job.part).is_file()]
        waiting[sequence.name] = set(missing)
        todo += missing
        total += sum(job.last - job.first for job in jobs)
        done += sum(job.last - job.first for job in jobs if job not in waiting[sequence.name])
    progress(done, total)

    def put_together(name: str) -> None:
        parts = _parts(folder, name, split, salt)
        assemble(split, split.find_sequence(name), parts, folder / f"{name}.mcap", salt)
        shutil.rmtree(parts, ignore_errors=True)

    for name in [name for name, missing in waiting.items() if not missing]:
        put_together(name)
    for job in run_jobs(split, todo, folder, workers, salt):
        done += job.last - job.first
        progress(done, total)
        waiting[job.sequence].discard(job)
        if not waiting[job.sequence]:
            put_together(job.sequence)


def run_jobs(split: SplitRecipe, jobs: list[Job], folder: Path, workers: int, salt: bytes) -> Iterator[Job]:
    """Run jobs in this process (one worker) or in several, and yield each when its part is there."""
    if workers <= 1 or len(jobs) <= 1:
        for job in jobs:
            run_job(split, job, _parts(folder, job.sequence, split, salt), salt)
            yield job
        return
    pool = ProcessPoolExecutor(
        min(workers, len(jobs)), mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    try:
        pool.submit(_warm_up).result()  # one process compiles the kernels, the others find them
        pending: dict[Future[None], Job] = {}
        queue = iter(jobs)
        while True:
            # A short queue: an interruption leaves little behind that was asked for and not done.
            while len(pending) < 2 * workers and (next_job := next(queue, None)) is not None:
                parts = _parts(folder, next_job.sequence, split, salt)
                pending[pool.submit(run_job, split, next_job, parts, salt)] = next_job
            if not pending:
                break
            finished, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                job = pending.pop(future)
                future.result()
                yield job
    except BrokenProcessPool:
        raise OysterbenchError(
            "a render worker was killed (out of memory?); the frames that were finished are kept: run the same command "
            "again, with fewer --workers"
        ) from None
    except BaseException:
        for process in list(pool._processes.values()):  # on Ctrl-C do not wait for the frames under way
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    parent = multiprocessing.parent_process()

    def leave_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=leave_with_parent, daemon=True).start()
    import cv2

    cv2.setNumThreads(1)


def _warm_up() -> None:
    from oysterbench.render.camera import warm_up

    warm_up()


def run_job(split: SplitRecipe, job: Job, parts: Path, salt: bytes = b"") -> None:
    """Do a job and leave its part file."""
    from oysterbench.recording import oyster_csv, recorders, sensor_messages
    from oysterbench.stage import build_stage

    stage = build_stage(split, job.sequence, salt)
    tables = {}
    if job.source:
        messages = recorders(stage)[job.source](job.first, job.last)
    else:
        messages = sensor_messages(stage)
        tables[OYSTERS] = oyster_csv(stage)
    kinds = topics.rig_topics(split.rig)
    types = {name: kinds[name] for name, source in _sources(split.rig).items() if source == job.source}
    write_atomically(parts / job.part, pack(messages, types, tables))


def _sources(rig: RigRecipe) -> dict[str, str]:
    """Topic -> the source of the jobs whose parts hold it, in the order of the file; all but the rig's frames."""
    bulky = {name: camera.name for camera in rig.camera for name in topics.camera_topics(camera.name)}
    bulky |= {name: sonar.name for sonar in rig.sonar for name in topics.sonar_topics(sonar.name)}
    return {name: bulky.get(name, "") for name in topics.rig_topics(rig) if name != topics.TF_STATIC}


def assemble(split: SplitRecipe, recipe: SequenceRecipe, parts: Path, path: Path, salt: bytes = b"") -> None:
    """Put the parts of a sequence together, in time order; the file appears in one step."""
    from oysterbench.calibration import rig_calibration

    calibration = rig_calibration(split.rig, recipe.site)
    jobs = plan(split, recipe)
    temporary = parts / "whole.mcap"  # beside the parts, so that what a kill leaves goes with them
    with open(temporary, "wb") as file:
        writer = SequenceWriter(file, topics.rig_topics(split.rig))
        writer.metadata(
            METADATA,
            {
                "sequence": recipe.name,
                "split": split.name,
                "split_version": split.version,
                "track": split.track,
                "rig": split.rig.name,
                "digest": digest(split, salt),
                "oysterbench": VERSION,
            },
        )
        writer.attachment(CALIBRATION, "application/json", json.dumps(calibration, indent=1).encode())
        writer.attachment("classes.json", "application/json", json.dumps(CLASSES).encode())
        writer.attachment("split.toml", "application/toml", split.source.encode())
        writer.attachment("rig.toml", "application/toml", split.rig_source.encode())
        for name, table in read_attachments(parts / Job(recipe.name).part).items():
            writer.attachment(name, "text/csv", table)
        writer.write(topics.static_transforms(EPOCH_NS, _frames(split.rig, calibration)))
        writer.section()
        for topic, source in _sources(split.rig).items():  # a section each, so that reading one touches no other
            files = [parts / job.part for job in jobs if job.source == source]
            for message in _read_parts(files, topic):
                writer.write(message)
            writer.section()
        writer.finish()
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def _read_parts(files: list[Path], topic: str) -> Iterator[Message]:
    for file in files:
        yield from read_messages(file, [topic])


def _frames(rig: RigRecipe, calibration: dict[str, Any]) -> dict[str, tuple[Array, Array]]:
    """Poses in base_link of the rig's frames: name -> (position (3,) m, quaternion (4,))."""
    from scipy.spatial.transform import Rotation

    frames = {}
    for name, keys in topics.rig_frames(rig).items():
        entry = calibration
        for key in keys:
            entry = entry[key]
        T = np.array(next(value for key, value in entry.items() if key.startswith("T_base_")))
        frames[name] = (T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True))
    return frames


def check_workers(workers: int | None) -> int:
    """Number of workers: as asked, or one per core that this process may use."""
    if workers is None:
        return len(os.sched_getaffinity(0))
    if workers < 1:
        raise RecipeError(f"--workers: expected at least 1, got {workers}")
    return workers
