"""Who may upload at the same time. Places are few, and a slow upload holds one for long: so when all are taken, the
team that has held places for longest gives way to one that has had less time."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager

from oysterbench.hub.addresses import network
from oysterbench_leaderboard.submissions.accounts.rates import DAY_S
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.settings import SubmissionSettings

RETRY_S = 60


class Place:
    """The place of one upload. It can be taken away only while the upload's body is being received."""

    def __init__(self, team: str, address: str, since: float) -> None:
        self.team, self.address, self.since = team, network(address), since
        self._end: asyncio.Timeout | None = None

    @property
    def takeable(self) -> bool:
        """Whether its body is being received, so that it can be taken away."""
        return self._end is not None

    def take(self) -> None:
        """Take the place away: end the reception of its body."""
        if self._end is not None:
            self._end.reschedule(asyncio.get_running_loop().time())
            self._end = None

    @asynccontextmanager
    async def receiving(self) -> AsyncIterator[None]:
        """Context in which the body is received. Raises Refusal when the place is taken away."""
        try:
            async with asyncio.timeout(None) as self._end:
                yield
        except TimeoutError:
            raise Refusal(
                "busy",
                "all places for uploads were taken, and this one went to a team that has sent for less time in the "
                "last days; nothing was counted, send it again in a minute",
                RETRY_S,
            ) from None
        finally:
            self._end = None


class Places:
    """Places of all uploads that a server receives; for one event loop.

    A team's time is the number of seconds for which it has held places, with a half-life of one day. To keep others
    out, an attacker must hold all places with accounts that have had less time than the others' upload takes: against
    one that takes T seconds, round the clock, this needs `uploads_at_once` * 125 000 / T accounts.
    """

    def __init__(self, settings: SubmissionSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self._settings, self._clock = settings, clock
        self._held: list[Place] = []
        self._had: dict[str, tuple[float, float]] = {}  # team -> seconds as they counted at a time, and that time

    def __len__(self) -> int:
        return len(self._held)

    @contextmanager
    def hold(self, team: str, address: str) -> Iterator[Place]:
        """Hold a place while the block runs. Raises Refusal where none is to be had."""
        self._make_room(team, network(address))
        place = Place(team, address, self._clock())
        self._held.append(place)
        try:
            yield place
        finally:
            self._leave(place)

    def _make_room(self, team: str, address: str) -> None:
        settings = self._settings
        for whose, most, count in (
            ("a team", settings.uploads_of_team, sum(place.team == team for place in self._held)),
            ("an address", settings.uploads_of_address, sum(place.address == address for place in self._held)),
        ):
            if count >= most:
                said = f"expected no more than {most} at once of {whose}, of which so many are being received"
                raise Refusal("busy", f"too many uploads: {said}; send this one when one of them has ended", RETRY_S)
        if len(self._held) < settings.uploads_at_once:
            return
        takeable = [place for place in self._held if place.takeable]
        longest = max(takeable, key=lambda place: self._seconds(place.team), default=None)
        if longest is None or self._seconds(longest.team) <= max(settings.upload_safe_s, self._seconds(team)):
            said = f"all {settings.uploads_at_once} places are taken"
            raise Refusal("busy", f"too many uploads at once: {said}; try again in a minute", RETRY_S)
        longest.take()
        self._leave(longest)

    def _leave(self, place: Place) -> None:
        """Free a place, unless it was taken away before, and count the time for which its team held it."""
        if place in self._held:
            self._had[place.team] = self._seconds(place.team), self._clock()
            self._held.remove(place)

    def _seconds(self, team: str) -> float:
        """A team's time in seconds, including its uploads in progress."""
        now = self._clock()
        seconds, at = self._had.get(team, (0.0, -math.inf))
        since = [max(place.since, at) for place in self._held if place.team == team]
        return seconds * math.exp2((at - now) / DAY_S) + sum(now - begun for begun in since)
