"""Cases run one by one, each in a process of its own that is forked from one that has loaded all, under a watchdog."""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import resource
import select
import signal
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path

LIMIT_S, LIMIT_BYTES = 10.0, 800_000_000
"""What a case may take: of processor time, so that a busy machine is no fault of the reader's, and of memory beyond the
some 200 MB that a reader has loaded when it begins."""

WALL_S = 60.0
"""After which it hangs, whatever processor time it took."""

ADDRESS_SPACE = 8_000_000_000
"""Bytes of a case that would take the machine's memory."""

FAULTS = ("traceback", "crash", "slow", "memory", "wrong")


@dataclass(frozen=True)
class Outcome:
    """Of a case: what came of it ("refused", "read", ... or one of FAULTS), and what was said of it."""

    number: int
    kind: str
    what: str
    says: str
    wall_s: float
    cpu_s: float
    memory_bytes: int
    """At most, beyond what was loaded before."""


class Wrong(Exception):
    """What a case raises where it was read, and not as it should be."""


def run(number: int, kind: str, case: Callable[[], tuple[str, str]]) -> Outcome:
    """Run a case, which returns what came of it, and what was said. Whatever it raises is a fault."""
    read, write = os.pipe()
    # What is garbage here must not be freed in the child, which would then be charged less than it takes.
    gc.freeze()
    _give_back()
    loaded = _anonymous_bytes()
    begun = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(read)
        _answer(case, write)
    gc.unfreeze()
    os.close(write)
    with open(read, "rb") as pipe:
        answer = b""
        while (left := begun + WALL_S - time.monotonic()) > 0:
            if select.select([pipe], [], [], left)[0]:
                part = os.read(pipe.fileno(), 1 << 16)
                answer += part
                if not part:
                    break
        else:
            os.kill(child, signal.SIGKILL)
    _, status, used = os.wait4(child, 0)
    wall, cpu = time.monotonic() - begun, used.ru_utime + used.ru_stime
    memory = max(0, used.ru_maxrss * 1024 - loaded)
    what, says = json.loads(answer) if status == 0 else ("crash", f"ended with status {status}")
    if cpu > LIMIT_S or wall > WALL_S:
        what = "slow"
    elif memory > LIMIT_BYTES:
        what = "memory"
    return Outcome(number, kind, what, says, round(wall, 3), round(cpu, 3), memory)


def _give_back() -> None:
    """Give the system what the heap keeps for use, which a case would take first, and not be charged for."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc
    if trim is not None:
        trim(0)


def _anonymous_bytes() -> int:
    """Resident memory of this process that is no file's: a forked one begins with it, and counts it as its own."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("RssAnon:")[2].split()[0]) * 1024


def _answer(case: Callable[[], tuple[str, str]], write: int) -> None:
    """In the child: run the case, and end."""
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        answer = case()
    except Wrong as error:
        answer = ("wrong", str(error))
    except BaseException:
        answer = ("traceback", traceback.format_exc())
    with open(write, "wb") as pipe:
        pipe.write(json.dumps(answer).encode())
    os._exit(0)


Draw = Callable[[int], tuple[str, Callable[[], tuple[str, str]]]]
"""Number of a case -> its kind, and the case."""


def tool(description: str | None, make: Callable[[int], Draw]) -> int:
    """The command of a tool: runs cases, prints what came of them, and returns how many were at fault.

    make: takes a seed, returns what draws the cases
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--log", type=Path, help="a line of JSON for each case")
    options = parser.parse_args()
    outcomes = _logged(options.log)
    draw = make(options.seed)
    for number in range(options.first, options.first + options.count):
        if number not in outcomes:
            outcomes[number] = run(number, *draw(number))
            if options.log:
                with open(options.log, "a", encoding="utf-8") as log:
                    log.write(json.dumps(asdict(outcomes[number])) + "\n")
    wanted = range(options.first, options.first + options.count)
    return report([outcome for number, outcome in outcomes.items() if number in wanted])


def _logged(log: Path | None) -> dict[int, Outcome]:
    """What a log has, by number."""
    if log is None or not log.exists():
        return {}
    names = {field.name for field in fields(Outcome)}
    rows = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    return {row["number"]: Outcome(**{name: row[name] for name in names}) for row in rows}


def report(outcomes: list[Outcome]) -> int:
    """Print the outcomes by kind, the worst of them, and each fault; how many faults there are."""
    counts = Counter((outcome.kind, outcome.what) for outcome in outcomes)
    names = sorted({what for _, what in counts})
    print(f"{'':28}" + "".join(f"{name:>12}" for name in names))
    for kind in sorted({kind for kind, _ in counts}):
        print(f"{kind:28}" + "".join(f"{counts[kind, name]:12}" for name in names))
    print(f"{'all':28}" + "".join(f"{sum(n for (_, w), n in counts.items() if w == name):12}" for name in names))
    slowest, largest = max(outcomes, key=lambda one: one.cpu_s), max(outcomes, key=lambda one: one.memory_bytes)
    print(f"most processor time {slowest.cpu_s} s (case {slowest.number}), longest wall ", end="")
    print(f"{max(one.wall_s for one in outcomes)} s, most memory {largest.memory_bytes / 1e6:.0f} MB ", end="")
    print(f"(case {largest.number}), processor time in all {sum(one.cpu_s for one in outcomes):.0f} s")
    faults = [outcome for outcome in outcomes if outcome.what in FAULTS]
    for fault in faults:
        print(f"case {fault.number}, {fault.kind}: {fault.what}: {fault.says}")
    return len(faults)
