"""Inputs for the runs of one call: each is made once, and deleted when no run needs it any more."""

from __future__ import annotations

import hashlib
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from threading import Lock

from oysterbench.core.errors import LabelError, MachineError, MethodError, SequenceError
from oysterbench.methods.exports import Exports, key_of, most_gigabytes
from oysterbench.methods.outcomes import Job
from oysterbench.methods.processes import Processes
from oysterbench.methods.sandbox import can_hide

Announce = Callable[[str], None]


class Inputs:
    """Sequences in the forms that methods read, each made once.

    scratch: folder whose path does not reveal where the sequences come from, also of what the runs write; exports:
    folder where inputs in lasting forms are kept for other runs, except those of hidden splits; only a program that is
    given an input can read it, and none can write to it
    """

    def __init__(
        self,
        scratch: Path,
        jobs: Sequence[Job],
        processes: Processes,
        exports: Path | None = None,
        announce: Announce = lambda text: None,
    ) -> None:
        self.scratch, self._processes, self._announce = scratch, processes, announce
        self._exports = None if exports is None or most_gigabytes() == 0 else Exports(exports)
        self._wanted = Counter(self._key(job) for job in jobs)
        self._locks = {key: Lock() for key in self._wanted}
        self._held = {key: ExitStack() for key in self._wanted}
        self._count = Lock()

    @property
    def hidden(self) -> tuple[Path, ...]:
        """Folders that no program may open, apart from its own input and output."""
        return (self.scratch,) if self._exports is None else (self.scratch, self._exports.folder)

    def of(self, job: Job) -> Path:
        """Path of a job's input, which is made now if it does not exist. Raises MachineError where it cannot be made:
        the method is not to blame."""
        key = self._key(job)
        name = job.adapter.interface.input_name(job.sequence, job.adapter.form)
        place = self.scratch / key / name
        with self._locks[key]:
            if place.exists():  # true for a link to a kept export, too
                return place.resolve()
            place.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._make(job, key, place)
            except (MethodError, SequenceError, LabelError) as error:
                raise MachineError(f"its input {{{job.adapter.form}}} could not be made: {error}") from None
        return place.resolve()

    def _make(self, job: Job, key: str, place: Path) -> None:
        secret = job.sequence.split is not None and job.sequence.split.hidden
        if self._exports is None or secret or job.adapter.form not in job.adapter.interface.lasting:
            job.sequence.write_input(job.adapter.form, place, self._processes)
            return
        kept = self._kept(self._exports, job, key) / place.name
        if can_hide():
            place.symlink_to(kept.absolute())
        else:  # a copy, as nothing would stop the program from reading the other exports, or writing
            shutil.copytree(kept, place)

    def _kept(self, exports: Exports, job: Job, key: str) -> Path:
        """Folder of the export that is kept for other runs, held until the last job is done."""

        def make(folder: Path) -> None:
            self._announce(f"writing {job.sequence.name} as {job.adapter.form}, kept for other runs")
            name = job.adapter.interface.input_name(job.sequence, job.adapter.form)
            job.sequence.write_input(job.adapter.form, folder / name, self._processes)

        lasting = key_of(job.sequence, job.adapter.form)
        return self._held[key].enter_context(exports.hold(lasting, make, self._processes.raise_if_stopped))

    def done(self, job: Job) -> None:
        """Note that a job no longer needs its input; the last job to do so deletes it."""
        key = self._key(job)
        with self._count:
            self._wanted[key] -= 1
            last = self._wanted[key] == 0
        if last:
            shutil.rmtree(self.scratch / key, ignore_errors=True)
            self._held[key].close()

    def close(self) -> None:
        """Release all exports and tidy their folder: no job needs any input any more."""
        for held in self._held.values():
            held.close()
        if self._exports is not None:
            self._exports.tidy()

    @staticmethod
    def _key(job: Job) -> str:
        origin = hashlib.sha256(job.sequence.origin.encode(errors="surrogateescape")).hexdigest()[:8]
        return f"{job.sequence.name}-{job.adapter.form}-{origin}"
