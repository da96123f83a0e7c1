"""Rate limits: on lines in the log, where those left out are counted, and on uploads that are read."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable

from oysterbench_leaderboard.submissions.reading.refusals import Refusal

DAY_S = 86400.0
WINDOW_S = 60.0
STRANGERS = ""
"""Key under which all addresses are counted together."""


class Sampler:
    """Decides which lines are written: in a window of WINDOW_S, at most `of_one` for each team or address, and at most
    `of_strangers` for all addresses together."""

    def __init__(self, of_one: int, of_strangers: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._of_one, self._of_strangers, self._clock = of_one, of_strangers, clock
        self._written: dict[str, deque[float]] = {}
        self._left_out: Counter[str] = Counter()
        self._lock = threading.Lock()

    def ask(self, who: str, stranger: bool) -> int | None:
        """Return how many lines from the same source were left out before this one; None where this one is left out
        too. Lines left out for strangers are reported with the next line from any stranger."""
        shares = {who: self._of_one} | ({STRANGERS: self._of_strangers} if stranger else {})
        counted = STRANGERS if stranger else who
        with self._lock:
            now = self._clock()
            self._forget(now - WINDOW_S)
            if any(len(self._written.get(key, ())) >= most for key, most in shares.items()):
                self._left_out[counted] += 1
                return None
            for key in shares:
                self._written.setdefault(key, deque()).append(now)
            return self._left_out.pop(counted, 0)

    def _forget(self, oldest: float) -> None:
        for key in [key for key, times in self._written.items() if times[-1] < oldest]:
            del self._written[key]
        for times in self._written.values():
            while times[0] < oldest:
                times.popleft()


class DailyReads:
    """Limit on the uploads of each team that are read in 24 hours. Reading costs the server as much when it ends in a
    refusal, which no other quota counts."""

    def __init__(self, most: int, clock: Callable[[], float] = time.time) -> None:
        self._most, self._clock = most, clock
        self._read: dict[str, deque[float]] = {}
        self._lock = threading.Lock()

    def check(self, team: str) -> None:
        """Raises Refusal where one more upload would exceed the limit."""
        now = self._clock()
        times = self._read.get(team, deque())
        if len(times) == self._most and times[0] > now - DAY_S:
            wait_s = int(times[0] + DAY_S - now) + 1
            raise Refusal(
                "quota",
                f"{self._most} uploads in 24 hours, refused ones included, are the limit for a team; the next is "
                f"accepted in {hours_and_minutes(wait_s)}",
                wait_s,
            )

    def count(self, team: str) -> None:
        """Count one more upload. Raises Refusal where that would exceed the limit."""
        with self._lock:
            self.check(team)
            self._read.setdefault(team, deque(maxlen=self._most)).append(self._clock())


def hours_and_minutes(wait_s: int) -> str:
    """Format a waiting time in s, rounded up to minutes.

    >>> hours_and_minutes(86399), hours_and_minutes(60), hours_and_minutes(61)
    ('24 h 0 min', '0 h 1 min', '0 h 2 min')
    """
    minutes = -(-wait_s // 60)
    return f"{minutes // 60} h {minutes % 60} min"
