"""Recipe to sequence files: a list of independent jobs, run anywhere, resumed where they were stopped.

A job renders one frame of a camera or one ping of a sonar, or simulates all other sensors, and its bytes are kept as a
part file. A part is there whole or not at all; when all parts of a sequence are there, they are put together in time
order, and the sequence appears in one step. So the bytes depend neither on the number of workers, nor on where they
are, nor on how often the work was interrupted. A part costs some 3 ms beyond its frame, which takes hundreds.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.core.errors import OysterbenchError, RecipeError, SequenceError
from oysterbench.core.files import home, locked, write_atomically
from oysterbench.core.geometry import Array
from oysterbench.core.ros import EPOCH_NS, TF_STATIC, Message
from oysterbench.recipe import CLASSES, REEF_CLASSES, RigRecipe, SequenceRecipe, SplitRecipe, count
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.registry import calibrate_rig, kind_of, rig_frames, rig_sensors
from oysterbench.sequence.file import read_attachments, read_messages
from oysterbench.sequence.read import (
    CALIBRATION,
    FAULTS,
    FRAMES,
    METADATA,
    MOVING,
    MOVING_POSES,
    OYSTERS,
    STEERING,
    TRUE_CALIBRATION,
    McapSequence,
)
from oysterbench.sequence.truth import rig_topics, static_transforms
from oysterbench.sequence.write import SequenceWriter, pack
from oysterbench.simulation import cost
from oysterbench.simulation.salt import HOW_TO_MAKE, LEAST_BYTES, Salt, is_strong
from oysterbench.simulation.scheduling import Results, run_here, run_in_processes, run_on_cluster
from oysterbench.version import VERSION

WORKER_S = 10.0
"""Of rendering that a worker must find to be worth its start, which takes some 4 s of processor time."""

GENERATION = 4
"""Raised whenever the same recipe begins to give other bytes, so that no cached file is taken for a new one."""

PROGRAM = f"oysterbench {VERSION}, generation {GENERATION}"
"""What decides the bytes besides the recipe: workers elsewhere must have the same."""

Progress = Callable[[int, int], None]
"""Called with the frames done and the frames wanted."""


@dataclass(frozen=True)
class Job:
    """A frame or ping of a camera or sonar, by its name; or, without one, all the small sensors."""

    sequence: str
    source: str = ""
    frame: int = 0

    @property
    def part(self) -> str:
        """Name of the file that keeps its bytes."""
        return f"{self.source}-{self.frame:06d}.part" if self.source else "sensors.part"

    @property
    def frames(self) -> int:
        """How many frames it makes, for counting."""
        return 1 if self.source else 0


def digest(split: SplitRecipe, salt: bytes = b"", device: str = "cpu") -> str:
    """SHA-256 of all that decides the bytes: recipe, rig, salt, the generation of this program, and the kind of device.

    The last bits of what a GPU computes are its own, so that its files are never taken for those of a processor.
    """
    text = f"{GENERATION} {split.digest()} {hashlib.sha256(salt).hexdigest()}"
    if device != "cpu":
        text += f" {device.partition(':')[0]}"
    return hashlib.sha256(text.encode()).hexdigest()


def split_folder(split: SplitRecipe, salt: bytes = b"", device: str = "cpu") -> Path:
    """Where a split is kept under `OYSTERBENCH_HOME`; another recipe under the same name has another folder."""
    return home() / "splits" / split.name / f"{split.version}-{digest(split, salt, device)[:12]}"


def sequence_files(split: SplitRecipe, folder: Path) -> dict[str, Path]:
    """Sequence name -> file."""
    return {sequence.name: folder / f"{sequence.name}.mcap" for sequence in split.sequence}


def is_complete(split: SplitRecipe, folder: Path) -> bool:
    """Whether every sequence file of the split is there."""
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
) -> dict[str, Path]:
    """Make the sequence files of a split (or those of these names) that are not there yet, and return all of them.

    workers: processes of this machine, unless the address of a Dask `scheduler` is given. device: of Warp, on the
    machines that render.

    Raises RecipeError where the recipe cannot be built or a hidden split is given no salt that keeps it hidden, and
    SequenceError where the folder holds a damaged file or one of another recipe; nothing that is there is overwritten.
    """
    if split.hidden and not is_strong(salt):
        raise RecipeError(
            f"split {split.name} is hidden: it is made with a secret salt only, of at least {LEAST_BYTES} mixed bytes, "
            f"and got {len(salt)}; {HOW_TO_MAKE}"
        )
    wanted = [split.find_sequence(name) for name in names] or split.sequence
    made_by = digest(split, salt, device)
    files = {sequence.name: sequence_files(split, folder)[sequence.name] for sequence in wanted}
    # A file appears when it is whole: who asks for no other need not wait for those that are being rendered.
    if all(path.exists() and not _parts(folder, name, made_by).exists() for name, path in files.items()):
        for path in files.values():
            _check_made_by(path, split, made_by)
        return files
    with locked(folder / ".lock"):
        for name, path in files.items():
            if path.exists():
                _check_made_by(path, split, made_by)
                shutil.rmtree(_parts(folder, name, made_by), ignore_errors=True)
        missing = [sequence for sequence in wanted if not files[sequence.name].exists()]
        if missing:
            task = partial(make_timed_part, split, salt=Salt(salt), device=device, program=PROGRAM)

            def run(jobs: list[Job]) -> Results[Job, Timed]:
                if scheduler is not None:
                    return run_on_cluster(task, jobs, scheduler)
                if workers > 1 and len(jobs) > 1:
                    return run_in_processes(task, jobs, workers, partial(_warm_up, device))
                return run_here(task, jobs)

            _render(split, missing, folder, made_by, salt, run, progress or (lambda done, total: None))
        with contextlib.suppress(OSError):  # absent, or with parts of other recipes in it
            (folder / ".parts").rmdir()
    return files


def _check_made_by(path: Path, split: SplitRecipe, made_by: str) -> None:
    if McapSequence(path).metadata.get("digest") != made_by:
        raise SequenceError(
            f"{path} was made by another recipe of {split.name} (or with another salt, on another kind of device, by "
            "another version of oysterbench); it was left as it is: delete it or choose another folder with --out"
        )


def _parts(folder: Path, sequence: str, made_by: str) -> Path:
    return folder / ".parts" / f"{sequence}-{made_by[:12]}"


def plan(split: SplitRecipe, sequence: SequenceRecipe) -> list[Job]:
    """All jobs of a sequence."""
    jobs = [Job(sequence.name)]
    for source, recipe in bulky_sensors(split.rig_of(sequence)).items():
        jobs += [Job(sequence.name, source, frame) for frame in range(count(sequence.duration_s, recipe.rate_hz))]
    return jobs


def bulky_sensors(rig: RigRecipe) -> dict[str, SensorRecipe]:
    """Name -> recipe of the sensors of which each measurement is a job of its own."""
    return {kind.name_of(recipe): recipe for kind, recipe in rig_sensors(rig) if kind.bulky}


def _render(
    split: SplitRecipe,
    sequences: list[SequenceRecipe],
    folder: Path,
    made_by: str,
    salt: bytes,
    run: Callable[[list[Job]], Results[Job, Timed]],
    progress: Progress,
) -> None:
    """Run the jobs that have left no part yet; put each sequence together as soon as its last part is there."""
    waiting: dict[str, set[Job]] = {}
    todo: list[Job] = []
    done = total = 0
    for sequence in sequences:
        parts = _parts(folder, sequence.name, made_by)
        jobs = plan(split, sequence)
        missing = [job for job in jobs if not (parts / job.part).is_file()]
        waiting[sequence.name] = set(missing)
        todo += missing
        total += sum(job.frames for job in jobs)
        done += sum(job.frames for job in jobs if job not in waiting[sequence.name])
    progress(done, total)

    def put_together(name: str) -> None:
        parts = _parts(folder, name, made_by)
        assemble(split, split.find_sequence(name), parts, folder / f"{name}.mcap", made_by, salt)
        cost.keep(folder, name, parts)
        shutil.rmtree(parts, ignore_errors=True)

    for name in [name for name, missing in waiting.items() if not missing]:
        put_together(name)
    with contextlib.closing(run(todo)) as results:
        for job, (part, cpu_s) in results:
            parts = _parts(folder, job.sequence, made_by)
            write_atomically(parts / job.part, part)
            cost.add(parts, cpu_s)
            done += job.frames
            progress(done, total)
            waiting[job.sequence].discard(job)
            if not waiting[job.sequence]:
                put_together(job.sequence)


def _warm_up(device: str) -> None:
    """Compile the kernels; the other processes find them."""
    from oysterbench.render.camera import warm_up
    from oysterbench.render.device import check_device

    check_device(device)
    warm_up(device)


Timed = tuple[bytes, float]
"""A part, and the processor time, s, that it took, in which the building of a worker's sequence is."""


def make_timed_part(split: SplitRecipe, job: Job, salt: bytes, device: str, program: str) -> Timed:
    """`make_part`, and its processor time."""
    began = time.process_time()
    part = make_part(split, job, salt, device, program)
    return part, time.process_time() - began


def make_part(split: SplitRecipe, job: Job, salt: bytes, device: str, program: str) -> bytes:
    """Do a job: the bytes of its part, which are the same wherever it is done by the same program."""
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
    types = {name: kinds[name] for name, source in _sources(simulated.rig).items() if source == job.source}
    return pack(messages, types, tables)


def _sources(rig: RigRecipe) -> dict[str, str]:
    """Topic -> the source of the jobs whose parts hold it, in the order of the file; all but the rig's frames."""
    bulky = {topic: name for name, recipe in bulky_sensors(rig).items() for topic in kind_of(recipe).topics(recipe)}
    return {name: bulky.get(name, "") for name in rig_topics(rig) if name != TF_STATIC}


def assemble(
    split: SplitRecipe, recipe: SequenceRecipe, parts: Path, path: Path, made_by: str, salt: bytes = b""
) -> None:
    """Put the parts of a sequence together, in time order; the file appears in one step."""
    rig = split.rig_of(recipe)
    calibration = calibrate_rig(rig, recipe.site, recipe.calibration, split.streams_of(recipe, salt))
    jobs = plan(split, recipe)
    temporary = parts / "whole.mcap"  # beside the parts, so that what a kill leaves goes with them
    with open(temporary, "wb") as file:
        writer = SequenceWriter(file, rig_topics(rig))
        writer.metadata(
            METADATA,
            {
                "sequence": recipe.name,
                "split": split.name,
                "split_version": split.version,
                "track": split.track,
                "rig": rig.name,
                "digest": made_by,
                "oysterbench": VERSION,
            },
        )
        writer.attachment(CALIBRATION, "application/json", json.dumps(calibration.given, indent=1).encode())
        classes = CLASSES if recipe.life.moves else REEF_CLASSES
        writer.attachment("classes.json", "application/json", json.dumps(classes).encode())
        writer.attachment("split.toml", "application/toml", split.source.encode())
        writer.attachment("rig.toml", "application/toml", split.rig_source.encode())
        for name, table in read_attachments(parts / Job(recipe.name).part).items():
            writer.attachment(name, "text/csv", table)
        if calibration.true != calibration.given:
            truth = {**calibration.true, "errors": calibration.errors}
            writer.attachment(TRUE_CALIBRATION, "application/json", json.dumps(truth, indent=1).encode())
        writer.write(static_transforms(EPOCH_NS, _frames(rig, calibration.given)))
        writer.section()
        bulky = bulky_sensors(rig)
        for topic, source in _sources(rig).items():  # a section each, so that reading one touches no other
            files = [parts / job.part for job in jobs if job.source == source]
            messages = _read_parts(files, topic)
            if source:
                messages = kind_of(bulky[source]).pass_on(bulky[source], topic, messages)
            for message in messages:
                writer.write(message)
            writer.section()
        writer.finish()
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def _read_parts(files: list[Path], topic: str) -> Iterator[Message]:
    for file in files:
        yield from read_messages(file, [topic])


def _frames(rig: RigRecipe, calibration: Mapping[str, Any]) -> dict[str, tuple[Array, Array]]:
    """Poses in base_link of the rig's frames: name -> (position (3,) m, quaternion (4,))."""
    from scipy.spatial.transform import Rotation

    frames = {}
    for frame, (kind, name) in rig_frames(rig).items():
        entry = calibration[kind.key] if kind.single else calibration[kind.key][name]
        T = np.array(entry[kind.pose])
        frames[frame] = (T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True))
    return frames


def default_workers(cpu_s: float) -> int:
    """One per core that this process may use, but none that would have less to do than its start takes; at least one.

    cpu_s: processor time of all that is to be rendered.
    """
    return min(check_workers(None), 1 + int(cpu_s / WORKER_S))


def check_workers(workers: int | None) -> int:
    """Number of workers: as asked, or one per core that this process may use."""
    if workers is None:
        return len(os.sched_getaffinity(0))
    if workers < 1:
        raise RecipeError(f"--workers: expected at least 1, got {workers}")
    return workers
