"""Fetching one file in pieces from several mirrors at once: a piece counts once its hash is right."""

from __future__ import annotations

import contextlib
import enum
import os
import random
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable
from pathlib import Path

from oysterbench.core.errors import HubError, IntegrityError, NetworkError, SilentError
from oysterbench.hub.canonical import sha256
from oysterbench.hub.draft import Draft, drafts_left
from oysterbench.hub.part import Part
from oysterbench.hub.sources import Absence, Body, Patience, Refusal, Setback, Source

RUN = 8
"""Maximum number of pieces in one request."""

WRONG = 2
"""Number of times that a mirror sends the same piece with wrong bytes, after which it is not asked again."""

Count = Callable[[int], None]
"""Called with the number of bytes that were verified."""


class Found(enum.Enum):
    """Outcome of receiving a piece."""

    NEW = enum.auto()
    KNOWN = enum.auto()
    WRONG = enum.auto()


class Mirror:
    """A source, and what has been learnt about it so far."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.failure: str | None = None
        self.lied = False  # it gave wrong bytes
        self.answered = False  # however wrongly, when asked for a document
        self.refused: dict[str, Refusal] = {}  # by path
        self.whole = False  # it ignores ranges
        self.sweeping = threading.Lock()  # held by the one connection that reads a whole file from it

    def fail(self, why: str, lied: bool = False) -> None:
        """Mark this mirror as not to be asked again. lied: it gave wrong bytes"""
        self.failure, self.lied = why, self.lied or lied

    def why_not(self, path: str) -> str | None:
        """Why this mirror is not asked for a file, or None."""
        refusal = self.refused.get(path)
        return self.failure or (None if refusal is None else str(refusal))

    def lacks(self, path: str) -> bool:
        """Whether this mirror is not asked for a file because it does not have it."""
        return self.failure is None and isinstance(self.refused.get(path), Absence)


def no_mirror_left(what: str, path: str, mirrors: Iterable[Mirror]) -> HubError:
    """Error to raise where no mirror can give a file; a SilentError only where none ever answered, to the index."""
    mirrors = list(mirrors)
    reasons = "; ".join(f"{mirror.source.name}: {mirror.why_not(path)}" for mirror in mirrors)
    kind: type[HubError] = NetworkError
    if any(mirror.lied for mirror in mirrors):
        kind = IntegrityError
    elif path == "index.json" and not any(mirror.answered for mirror in mirrors):
        kind = SilentError
    return kind(f"{what} could not be fetched: {reasons}")


def pause_s(attempt: int, asked_s: float, patience: Patience) -> float:
    """Seconds to wait before the next attempt: doubled each time, with jitter, and no less than the server asks for.

    The jitter is the only random number in oysterbench that no seed decides: clients must not return all at once.
    """
    wait = min(patience.first_wait_s * 2.0 ** (attempt - 1), patience.longest_wait_s) * random.uniform(0.5, 1.0)
    return max(wait, asked_s + random.uniform(0.0, 0.1) * asked_s)


class WrongPiece(Setback):
    """A piece that came whole, with wrong bytes."""


class Reader:
    """Reader of a body in portions of any size."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._left = memoryview(b"")

    def take(self, view: memoryview) -> int:
        """Copy the next bytes to the start of `view`, and return how many. Raises Setback at the end."""
        if not self._left:
            self._left = memoryview(self._body.read())
            if not self._left:
                raise Setback("the answer ended too early")
        n = min(len(view), len(self._left))
        view[:n] = self._left[:n]
        self._left = self._left[n:]
        return n


class Transfer:
    """Transfer of pieces of one part over several connections."""

    def __init__(self, part: Part, mirrors: list[Mirror], connections: int, patience: Patience, count: Count) -> None:
        self._part, self.entry = part, part.entry
        self.path = f"blobs/{part.entry.sha256}"
        self._mirrors = mirrors
        self._connections = connections
        self.patience = patience
        self._count = count
        self._lock = threading.Lock()
        self.stop = threading.Event()
        self._missing: set[int] = set()
        self._queue: deque[int] = deque()
        self._left: dict[int, Path] = {}  # pieces of which a killed process left the start
        self._wrong: Counter[tuple[Mirror, int]] = Counter()  # how often a mirror has sent a piece with wrong bytes
        self._error: BaseException | None = None

    def fetch(self, pieces: Iterable[int]) -> None:
        """Fetch what is missing of these pieces.

        Raises IntegrityError or NetworkError when no mirror is left to ask; what was fetched stays in the part.
        """
        left = drafts_left(self._part.path)
        for piece in pieces:
            if self._part.is_right(piece):
                self._count(self.entry.length(piece))
                if piece in left:
                    left.pop(piece).unlink(missing_ok=True)
            else:
                self._missing.add(piece)
        if not self._missing:
            return
        self._queue.extend(sorted(self._missing))
        self._left = left
        parallel = any(mirror.source.parallel for mirror in self._mirrors)
        n = min(self._connections if parallel else 1, len(self._queue))
        workers = [threading.Thread(target=self._work, args=(k,), daemon=True) for k in range(n)]
        try:
            for worker in workers:
                worker.start()
            for worker in workers:
                worker.join()
        finally:
            with self._lock:  # after an interruption, no more progress is reported
                self.stop.set()
        if self._error is not None:
            raise self._error
        if self._missing:
            total, there = len(self.entry.pieces), len(self.entry.pieces) - len(self._missing)
            error = no_mirror_left(self.entry.name, self.path, self._mirrors)
            then = f"{there} of {total} pieces are kept, and the same command resumes from there"
            if not there and all(one.lacks(self.path) for one in self._mirrors):
                then = (
                    "does the hub have it? `oysterbench splits --hub` and `oysterbench models --hub` list what it has"
                )
            raise type(error)(f"{error}; {then}")

    def _work(self, number: int) -> None:
        descriptor = self._part.duplicate()
        try:
            draft = Draft(self._part.path, self.entry)
            try:
                Connection(self, number, descriptor, draft).run()
            finally:
                draft.close()
        except BaseException as error:
            with self._lock:
                self._error = self._error or error
            self.stop.set()
        finally:
            os.close(descriptor)

    # Shared by the connections:

    def next_run(self) -> list[int]:
        """Take adjacent pieces that nobody is fetching yet; short runs towards the end, so that all finish together.
        Only the first may have a start that was left."""
        with self._lock:
            longest = max(1, min(RUN, len(self._queue) // (2 * self._connections)))
            run: list[int] = []
            while self._queue and len(run) < longest:
                if run and (self._queue[0] != run[-1] + 1 or self._queue[0] in self._left):
                    break
                piece = self._queue.popleft()
                if piece in self._missing:
                    run.append(piece)
            return run

    def take_left(self, piece: int) -> Path | None:
        """Draft of a piece that a killed process left, for whoever asks first; None where there is none."""
        with self._lock:
            return self._left.pop(piece, None)

    def give_back(self, run: list[int]) -> None:
        """Return to the queue the pieces that a connection could not fetch."""
        with self._lock:
            self._queue.extendleft(reversed(run))

    def alive(self) -> list[Mirror]:
        """Mirrors that can still be asked for the file."""
        return [mirror for mirror in self._mirrors if mirror.why_not(self.path) is None]

    def accept(self, piece: int, data: memoryview, descriptor: int) -> Found:
        """Keep a piece if its hash is right and it was missing. Hashing and writing do not block other connections."""
        if sha256(data) != self.entry.pieces[piece]:
            return Found.WRONG
        if not self.is_missing(piece):
            return Found.KNOWN
        self._part.write(piece, data, descriptor)
        with self._lock:
            if piece not in self._missing:
                return Found.KNOWN
            self._missing.discard(piece)
            if not self.stop.is_set():
                self._count(len(data))
            return Found.NEW

    def blame(self, mirror: Mirror, piece: int) -> None:
        """Count a piece with wrong bytes against the mirror that sent it."""
        with self._lock:
            self._wrong[mirror, piece] += 1
            if self._wrong[mirror, piece] >= WRONG:
                mirror.fail(f"piece {piece} of {self.entry.name} has wrong bytes", lied=True)

    def is_missing(self, piece: int | None = None) -> bool:
        """Whether a piece, or any, is missing."""
        with self._lock:
            return bool(self._missing) if piece is None else piece in self._missing


class Connection:
    """One of the workers of a transfer: it asks one mirror at a time for one run of pieces at a time."""

    def __init__(self, transfer: Transfer, number: int, descriptor: int, draft: Draft) -> None:
        self.t = transfer
        self._turn = number
        self._descriptor = descriptor
        self._draft = draft  # of the first piece of the run
        self._gained = 0  # bytes of progress made by the present attempt
        self._attempts: Counter[Mirror] = Counter()  # in a row that yielded nothing

    def run(self) -> None:
        """Fetch until nothing is missing or nobody is left to ask."""
        while not self.t.stop.is_set() and (run := self.t.next_run()):
            self._draft.begin(run[0])
            if (left := self.t.take_left(run[0])) is not None:
                self._draft.inherit(left)
            while run and not self.t.stop.is_set():
                alive = self.t.alive()
                if not alive:
                    self.t.give_back(run)
                    return
                mirror = alive[self._turn % len(alive)]
                self._gained = 0
                try:
                    self._ask(mirror, run)
                except Refusal as refusal:
                    mirror.refused[self.t.path] = refusal
                    self._change_mirror()
                except Setback as setback:
                    self._fall_back(mirror, setback)

    def _change_mirror(self) -> None:
        """Change to the next mirror. A piece comes from one mirror only, so that it is known which one is to blame."""
        self._turn += 1
        self._draft.clear()

    def _fall_back(self, mirror: Mirror, setback: Setback) -> None:
        """Decide what follows from a failed attempt: wait, ask another mirror, or never ask this one again."""
        if self.t.stop.is_set():
            return
        patience = self.t.patience
        came = self._gained >= patience.least_bytes
        self._attempts[mirror] = 1 if came else self._attempts[mirror] + 1
        if setback.wait_s > patience.longest_wait_s:
            mirror.fail(f"{setback}; it asks to come back in {setback.wait_s:.0f} s")
        elif self._attempts[mirror] >= patience.attempts:
            lied = isinstance(setback, WrongPiece)
            mirror.fail(f"{setback}, {self._attempts[mirror]} times in a row", lied)
        if mirror.failure or (not came and len(self.t.alive()) > 1):
            self._change_mirror()
        if not mirror.failure:
            patience.wait(self.t.stop, pause_s(self._attempts[mirror], setback.wait_s, patience))

    def _ask(self, mirror: Mirror, run: list[int]) -> None:
        """Request the run, and remove every piece that arrives from it."""
        if mirror.whole:
            self._sweep(mirror, run)
            return
        start, end = self.t.entry.span(run[0])[0] + self._draft.filled, self.t.entry.span(run[-1])[1]
        with mirror.source.open(self.t.path, start, end) as body:
            if body.start != start:
                mirror.whole = True
                self._sweep(mirror, run, body)
                return
            reader = Reader(body)
            while run:
                self._take(mirror, reader, run[0])
                del run[0]
                if run:
                    self._draft.begin(run[0])

    def _take(self, mirror: Mirror, reader: Reader, piece: int) -> None:
        """Read one piece to its end, and keep it. Raises Setback if the response ends early, or the piece is wrong."""
        draft = self._draft
        while draft.free:
            if self.t.stop.is_set():
                raise Setback("stopped")
            n = reader.take(draft.free)
            draft.add(n)
            self._gained += 0 if mirror.whole else n  # without ranges, an attempt restarts from nothing
        found, inherited = self.t.accept(piece, draft.there, self._descriptor), draft.inherited
        draft.clear()
        if found is Found.WRONG:
            if not inherited:
                self.t.blame(mirror, piece)
            raise WrongPiece(f"piece {piece} of {self.t.entry.name} has wrong bytes")
        if found is Found.NEW:
            self._attempts[mirror] = 0
            self._gained = max(self._gained, self.t.patience.least_bytes)

    def _sweep(self, mirror: Mirror, run: list[int], body: Body | None = None) -> None:
        """Read the whole file from a mirror that ignores ranges, and keep what was missing; one connection at a
        time."""
        if not mirror.sweeping.acquire(blocking=False):
            body = None  # another connection is already sweeping: drop this response, and wait for that one
            mirror.sweeping.acquire()
        try:
            if self.t.stop.is_set() or mirror.failure or not self.t.is_missing():
                return
            with contextlib.ExitStack() as stack:
                reader = Reader(body or stack.enter_context(mirror.source.open(self.t.path)))
                for piece in range(len(self.t.entry.pieces)):
                    if not self.t.is_missing():
                        break
                    self._draft.begin(piece, on_disk=False)  # the start of a piece is of no use here
                    self._take(mirror, reader, piece)
        finally:
            mirror.sweeping.release()
            run[:] = [piece for piece in run if self.t.is_missing(piece)]
            if run:
                self._draft.begin(run[0])
