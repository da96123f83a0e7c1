"""Places for uploads: whoever holds them for long gives way, and nobody keeps others out."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

import pytest

from oysterbench_leaderboard.submissions.accounts.rates import DAY_S
from oysterbench_leaderboard.submissions.places import Place, Places
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.settings import load_settings


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def places(tmp_path, clock) -> Places:
    return Places(load_settings(tmp_path), clock)


def refusal(places: Places, team: str, address: str = "10.1.0.0") -> str:
    with pytest.raises(Refusal) as caught, places.hold(team, address):
        pass
    assert (caught.value.kind, caught.value.status, caught.value.retry_s) == ("busy", 503, 60)
    return caught.value.reason


class Senders:
    """Teams whose bodies are being received, each until it is told to end. ended: team -> how it did"""

    def __init__(self, places: Places, stack: AsyncExitStack) -> None:
        self.places, self.stack = places, stack
        self.ended: dict[str, str] = {}
        self.tasks: dict[str, asyncio.Task[None]] = {}

    async def send(self, team: str, address: str) -> None:
        held = asyncio.Event()
        self.tasks[team] = asyncio.create_task(self._receive(team, address, held))
        self.stack.callback(self.tasks[team].cancel)
        begun = asyncio.create_task(held.wait())
        await asyncio.wait({begun, self.tasks[team]}, return_when=asyncio.FIRST_COMPLETED)
        begun.cancel()

    async def _receive(self, team: str, address: str, held: asyncio.Event) -> None:
        try:
            with self.places.hold(team, address) as place:
                async with place.receiving():
                    held.set()
                    await asyncio.Event().wait()
        except Refusal as refusal:
            self.ended[team] = refusal.reason


@asynccontextmanager
async def senders(places: Places, count: int) -> AsyncIterator[Senders]:
    async with AsyncExitStack() as stack:
        found = Senders(places, stack)
        for k in range(count):
            await found.send(f"slow {k}", f"10.0.0.{k}")
        yield found


def test_a_team_sends_one_at_a_time_and_an_address_four(places):
    with places.hold("reef lab", "10.0.0.1"):
        assert refusal(places, "reef lab").startswith("too many uploads: expected no more than 1 at once of a team")
    with places.hold("reef lab", "10.0.0.1"):  # it was given back
        pass

    async def four() -> None:
        async with senders(places, 0) as found:
            for k in range(4):
                await found.send(f"team {k}", f"2001:db8::{k}")
            assert "expected no more than 4 at once of an address" in refusal(places, "other", "2001:db8::9")

    asyncio.run(four())
    assert not len(places)


def test_where_all_places_are_taken_the_team_that_held_one_for_longest_gives_way(places, clock):
    async def play() -> dict[str, str]:
        async with senders(places, 0) as found:
            for k in range(8):
                clock.now = 50.0 * k
                await found.send(f"slow {k}", f"10.0.0.{k}")
            assert refusal(places, "honest").startswith("too many uploads at once: all 8 places are taken")
            clock.now = 610.0  # slow 0 has had its ten minutes
            await found.send("honest", "10.1.0.0")
            assert refusal(places, "another").startswith("too many uploads at once"), "slow 1 has not"
            await found.tasks["slow 0"]
            assert len(places) == 8
            return dict(found.ended)

    ended = asyncio.run(play())
    assert list(ended) == ["slow 0"]
    assert ended["slow 0"].startswith("all places for uploads were taken, and this one went to a team that has sent")


def test_teams_that_come_again_at_once_do_not_oust_the_one_that_took_their_place(places, clock):
    async def play() -> list[str]:
        async with senders(places, 8) as found:
            clock.now = 3000.0
            await found.send("honest", "10.1.0.0")
            for second in range(3001, 5048):  # 256 MB at 1 Mbit/s
                clock.now = float(second)
                for team in [team for team in found.ended if team != "honest"]:
                    del found.ended[team]
                    await found.send(team, f"10.2.0.{team[-1]}")
            return [team for team, task in found.tasks.items() if not task.done()]

    assert "honest" in asyncio.run(play())


def test_what_a_team_has_had_counts_half_after_a_day(places, clock):
    with places.hold("reef lab", "10.0.0.1"):
        clock.now = 1000.0
        assert places._seconds("reef lab") == 1000.0
    clock.now += DAY_S
    assert places._seconds("reef lab") == 500.0
    with places.hold("reef lab", "10.0.0.1"):
        clock.now += 10.0
        assert places._seconds("reef lab") == pytest.approx(510.0, abs=0.1)


def test_what_is_received_already_is_not_taken(places, clock):
    async def play() -> None:
        with places.hold("read now", "10.0.0.9") as place:
            async with place.receiving():
                assert place.takeable
            assert not place.takeable
            async with senders(places, 7) as found:
                clock.now = 5000.0
                await found.send("honest", "10.1.0.0")
                assert places._held[0] is place

    asyncio.run(play())


def test_what_fails_while_it_is_received_says_so_itself():
    async def play() -> None:
        async with Place("reef lab", "10.0.0.1", 0.0).receiving():
            raise Refusal("slow", "expected more")

    with pytest.raises(Refusal, match="expected more"):
        asyncio.run(play())
