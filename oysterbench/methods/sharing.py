"""How runs share a machine: as many side by side as fit into its memory, and its cores divided among these."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from oysterbench.core.errors import MethodError
from oysterbench.methods.outcomes import OUTCOME, Job, Outcome, read_outcome

ASSUMED_BYTES = 2 * 2**30
"""Memory that a method is assumed to need until one of its runs has been measured."""
MARGIN = 1.2
"""Memory reserved for a method's next run, as a multiple of its highest peak so far."""


def default_workers() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def available_bytes() -> int:
    """Memory that processes may still use, bytes: what the system has available, within the control group's limit."""
    found = []
    try:
        rows = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        found.append(int(rows["MemAvailable"].split()[0]) * 1024)
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
        if limit != "max":
            found.append(int(limit) - int(Path("/sys/fs/cgroup/memory.current").read_text()))
    except (OSError, KeyError, ValueError):
        pass  # not Linux, or no control group v2
    return min(found, default=2**62)


@dataclass
class Sharing:
    """Decides which of the waiting jobs start, and on how many cores.

    workers: jobs at a time at most; peaks: highest peak memory of runs so far, bytes, by name of the method; budget:
    memory for all jobs, bytes
    """

    workers: int
    peaks: dict[str, int] = field(default_factory=dict)
    budget: int = field(default_factory=available_bytes)

    def fits(self, job: Job, running: Collection[Job]) -> bool:
        """Whether one more job may start now. The first always may: it may as well try."""
        if not running:
            return True
        return len(running) < self.workers and self._need(job) + sum(map(self._need, running)) <= self.budget

    def cores(self, job: Job, running: Collection[Job], waiting: Sequence[Job]) -> int | None:
        """Number of cores for a job that starts now beside those running: those of the machine, divided by the number
        of jobs side by side once those waiting have started that fit. None if it will be alone: nothing is shared."""
        beside = [*running, job]
        for other in waiting:
            if not self.fits(other, beside):
                break
            beside.append(other)
        return max(1, default_workers() // len(beside)) if len(beside) > 1 else None

    def learn(self, job: Job, outcome: Outcome) -> None:
        """Take the memory that a run has used into account."""
        if peak := int(outcome.process["peak_bytes"]):  # 0 where it never started
            self.peaks[job.adapter.name] = max(self.peaks.get(job.adapter.name, 0), peak)

    def _need(self, job: Job) -> float:
        peak = self.peaks.get(job.adapter.name)
        return ASSUMED_BYTES if peak is None else MARGIN * peak


def known_peaks(jobs: Sequence[Job], root: Path) -> dict[str, int]:
    """Peak memory of the methods' earlier runs in this folder, bytes, by method name."""
    peaks: dict[str, int] = {}
    for name in {job.adapter.name for job in jobs}:
        for path in (root / "runs" / name).glob(f"*/*/{OUTCOME}"):
            try:
                outcome = read_outcome(path.parent)
            except MethodError:
                continue
            if outcome is not None and outcome.process["peak_bytes"]:
                peaks[name] = max(peaks.get(name, 0), int(outcome.process["peak_bytes"]))
    return peaks
