"""Runs one command, measures it, and leaves no process of it behind: a standalone program, for Linux.

    python -I -S supervise.py LIMIT_S REPORT COMMAND...

It imports only the standard library, so that what it measures is the command and not itself. It adopts the orphans of
the command, even those that became daemons, and kills every remaining process when the command ends, when the limit is
reached, when it receives SIGTERM, and when the process that started it dies. REPORT, the number of an open file
that the command does not inherit, receives JSON that says what happened:

status, signal: how the command ended; one of them is null
timed_out:      whether the limit was reached, though the command may have ended itself later
stopped:        whether SIGTERM was received
wall_s, cpu_s:  wall time of the command; user and system CPU time of all its descendants
peak_bytes:     the larger of two resident sizes: the peak of any single process, as recorded by the kernel, and the
                peak of all processes together, sampled every LOOK_S
left_behind:    number of processes that were still running when the command had ended
short:          whether the kernel killed a process of this machine for lack of memory in the meantime, or the command
                used most of the memory
error:          why the command could not be started; null if it was
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import sys
import time

LOOK_S = 0.2
KILLING_S = 30.0  # then give up on a process that the kernel does not release
PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h
WATCHED = {signal.SIGCHLD, signal.SIGTERM}
CHANGED_BY_PYTHON = {signal.SIGPIPE, signal.SIGXFSZ}
"""Signals that Python ignores, reset to their defaults for the command."""
PAGE = os.sysconf("SC_PAGE_SIZE")
MOST_MEMORY = 0.5
"""Share of the memory from which on a command may have been killed for lack of it."""


def descendants() -> dict[int, int]:
    """Process id -> resident bytes of all descendants of this process, zombies included."""
    parents, resident = {}, {}
    for name in os.listdir("/proc"):
        if not name.isdigit():
            continue
        try:
            with open(f"/proc/{name}/stat", "rb") as file:
                fields = file.read().rpartition(b")")[2].split()  # after the process name, which may contain anything
        except OSError:  # it has ended in the meantime
            continue
        parents[int(name)] = int(fields[1])
        resident[int(name)] = int(fields[21]) * PAGE
    found: set[int] = set()
    fresh = {os.getpid()}
    while fresh:
        fresh = {pid for pid, parent in parents.items() if parent in fresh} - found
        found |= fresh
    return {pid: resident[pid] for pid in found}


def oom_kills() -> int:
    """Number of processes that the kernel has killed for lack of memory since it started; 0 where it does not say."""
    with contextlib.suppress(OSError), open("/proc/vmstat") as file:
        return sum(int(line.split()[1]) for line in file if line.startswith("oom_kill "))
    return 0


def memory_bytes() -> int:
    """Memory of this machine or, where that is less, of the control group."""
    found = os.sysconf("SC_PHYS_PAGES") * PAGE
    with contextlib.suppress(OSError, ValueError), open("/sys/fs/cgroup/memory.max") as file:
        found = min(found, int(file.read()))
    return found


class Supervisor:
    """Supervisor of one command."""

    def __init__(self) -> None:
        self.cpu_s = 0.0
        self.peak_bytes = 0
        self.statuses: dict[int, int] = {}

    def run(self, command: list[str], limit_s: float) -> dict[str, object]:
        """Run the command, and return the content of REPORT."""
        start, kills = time.monotonic(), oom_kills()
        try:
            pid = os.posix_spawnp(command[0], command, os.environ, setsigmask=(), setsigdef=CHANGED_BY_PYTHON)
        except OSError as error:
            return {"error": f"{command[0]}: {error.strerror}"}
        timed_out = stopped = False
        while pid not in self.statuses and not timed_out and not stopped:
            left = start + limit_s - time.monotonic()
            woken = signal.sigtimedwait(WATCHED, max(0.0, min(LOOK_S, left)))
            stopped = woken is not None and woken.si_signo == signal.SIGTERM
            self.look()
            self.reap()
            # Also if it has ended since: it may have stopped this process until then.
            timed_out = time.monotonic() >= start + limit_s
        wall_s = time.monotonic() - start
        left_behind = len(descendants())
        self.kill()
        code = os.waitstatus_to_exitcode(self.statuses[pid]) if pid in self.statuses else -signal.SIGKILL
        return {
            "status": code if code >= 0 else None,
            "signal": -code if code < 0 else None,
            "timed_out": timed_out,
            "stopped": stopped,
            "wall_s": wall_s,
            "cpu_s": self.cpu_s,
            "peak_bytes": self.peak_bytes,
            "short": oom_kills() > kills or self.peak_bytes >= MOST_MEMORY * memory_bytes(),
            "left_behind": 0 if timed_out or stopped else left_behind,
            "error": None,
        }

    def look(self) -> None:
        """Record the memory in use."""
        self.peak_bytes = max(self.peak_bytes, sum(descendants().values()))

    def reap(self) -> bool:
        """Reap the children that have ended, and add up what they cost. Returns whether any child is left."""
        while True:
            try:
                pid, status, usage = os.wait4(-1, os.WNOHANG)
            except ChildProcessError:
                return False
            if pid == 0:
                return True
            self.statuses[pid] = status
            self.cpu_s += usage.ru_utime + usage.ru_stime
            self.peak_bytes = max(self.peak_bytes, usage.ru_maxrss * 1024)

    def kill(self) -> None:
        """Kill all descendants, repeatedly, as those that are still alive may start others."""
        end = time.monotonic() + KILLING_S
        while self.reap() and time.monotonic() < end:
            for pid in descendants():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            signal.sigtimedwait({signal.SIGCHLD}, 0.01)


def main(limit_s: str, report: str, *command: str) -> None:
    """Run the command and write the report."""
    os.set_inheritable(int(report), False)
    signal.pthread_sigmask(signal.SIG_BLOCK, WATCHED)
    parent = os.getppid()
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    for option, value in ((PR_SET_CHILD_SUBREAPER, 1), (PR_SET_PDEATHSIG, int(signal.SIGTERM))):
        if prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    if os.getppid() != parent:  # the parent died before it could be watched
        return
    result = Supervisor().run(list(command), float(limit_s))
    with open(int(report), "w", encoding="utf-8") as file:
        json.dump(result, file)


if __name__ == "__main__":
    main(*sys.argv[1:])
