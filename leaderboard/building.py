"""What an index is filled with: records read in several processes, sorted into boards, ranked."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import re
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import FAILED
from oysterbench.results.comparison import PRIMARY
from oysterbench_leaderboard.board import State
from oysterbench_leaderboard.intake import COLUMNS, Kept, keep
from oysterbench_leaderboard.ranking import Intervals, Map, standings

CHUNK = 200
"""Records that a process reads at a time."""

FEW = 4 * CHUNK
"""Up to so many records are read here: starting processes takes longer."""

Progress = Callable[[int, int], None]
"""Called with what is done, and of how much."""


@dataclass(frozen=True)
class Before:
    """A board as it was: its sequences, and the intervals of its records' scores."""

    sequences: Sequence[str]
    intervals: Intervals


@contextlib.contextmanager
def processes(count: int, workers: int | None = None) -> Iterator[Map]:
    """A `map` over so many processes for `count` records, by default one per core; the built-in one for few."""
    workers = workers or (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    if count <= FEW or workers < 2:
        yield map
        return
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker)
    try:
        with _one_thread_each():
            yield pool.map
    except BrokenProcessPool:
        raise ResultError(
            "a process that read records was killed (out of memory?); the index is as it was; run the command again"
        ) from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that are started meanwhile compute with one thread: there is one of them per core already."""
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = before


def _start_worker() -> None:
    """Ctrl-C is the parent's to handle; a worker leaves with its parent, even one that was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def leave_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=leave_with_parent, daemon=True).start()


def read(
    folder: Path, digests: Sequence[str], using: Map = map, progress: Progress | None = None
) -> tuple[list[Kept], dict[str, str]]:
    """What is kept of records in a folder; and those that cannot be used, digest -> why."""
    chunks = [(str(folder), list(digests[i : i + CHUNK])) for i in range(0, len(digests), CHUNK)]
    kept: list[Kept] = []
    problems: dict[str, str] = {}
    for done, (found, wrong) in enumerate(using(_read_chunk, chunks), start=1):
        kept += found
        problems |= wrong
        if progress is not None:
            progress(min(done * CHUNK, len(digests)), len(digests))
    return kept, problems


def _read_chunk(chunk: tuple[str, list[str]]) -> tuple[list[Kept], dict[str, str]]:
    folder, digests = chunk
    kept, problems = [], {}
    for digest in digests:
        try:
            with open(f"{folder}/{digest}.json", "rb") as file:
                data = file.read()
            kept.append(keep(data, digest))
        except ResultError as error:
            problems[digest] = str(error)
        except OSError as error:
            problems[digest] = f"cannot be read: {error.strerror or error}"
        except (TypeError, ValueError, AttributeError, KeyError, OverflowError) as error:
            problems[digest] = f"a value of the wrong kind ({type(error).__name__}: {error})"[:300]
    return kept, problems


def by_board(kept: Iterable[Kept]) -> dict[str, list[Kept]]:
    """Board -> its records, in the order of their digests, whatever order they come in."""
    boards: dict[str, list[Kept]] = {}
    for one in sorted(kept, key=lambda one: one.digest):
        boards.setdefault(one.board, []).append(one)
    return dict(sorted(boards.items()))


def board_rows(
    kept: Sequence[Kept],
    states: Mapping[str, State],
    using: Map = map,
    before: Before | None = None,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """A board (keys of `BoardInfo`, but newest) and the rows of all its records in its order, from all that it has.

    Its sequences are those of the current records, or of all where none is current: what was withdrawn takes no part.
    before: the board as it was, whose intervals are taken where they still hold.
    """
    first = kept[0]
    track, split, split_digest, evaluator, settings = first.about
    current = [one for one in kept if states[one.digest] == "current"]
    sequences = sorted({name for one in current or kept for name in one.sequences})
    intervals = before.intervals if before is not None and list(before.sequences) == sequences else {}
    ranked = (one.digest for one in current)
    places = standings((one.answers for one in kept), sequences, track, ranked, using, intervals)
    of = {one.digest: one for one in kept}
    rows = []
    for position, standing in enumerate(places):
        one = of[standing.digest]
        coverage = _coverage(one, sequences, track)
        columns = [coverage if key == "coverage" else v for key, v in zip(COLUMNS[track], one.columns, strict=True)]
        rows.append(
            {
                "digest": one.digest,
                "board": one.board,
                "position": position,
                "method": one.method,
                "team": one.team,
                "words": f"{one.method}\n{one.team}".casefold(),
                "tier": one.tier,
                "url": one.url,
                "summary": one.summary,
                "created": one.created,
                "supersedes": one.supersedes,
                "state": states[one.digest],
                "place": standing.place,
                "rank": standing.rank,
                "score": _number(standing.score),
                "low": _number(standing.low),
                "high": _number(standing.high),
                "data_set": one.data_set,
                "coverage": coverage,
                "sequences": len(one.sequences),
                "runs": one.runs,
                "failures": one.failed + sum(name not in one.sequences for name in sequences),
                **{f"m{i}": value for i, value in enumerate(columns)},
            }
        )
    info = {
        "id": first.board,
        "track": track,
        "split": split,
        "split_digest": split_digest,
        "evaluator_version": evaluator,
        "settings": settings,
        "metric": PRIMARY[track],
        "sequences": sequences,
        "entries": len(current),
        "updated": max(one.created for one in current or kept),
    }
    return info, rows


def _coverage(one: Kept, sequences: Sequence[str], track: str) -> float | None:
    failed = FAILED[track].get("coverage")
    values = [one.coverage.get(name, failed if name not in one.sequences else None) for name in sequences]
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def evaluator_order(version: str) -> tuple[tuple[int, int, str], ...]:
    """A key by which "slam 10" is later than "slam 9"."""
    parts = re.findall(r"\d+|\D+", version)
    return tuple((1, int(part), "") if part.isdigit() else (0, 0, part) for part in parts)
