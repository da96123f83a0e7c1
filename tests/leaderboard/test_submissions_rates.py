"""The log of refusals: nobody fills it, and nothing is left out in silence."""

from __future__ import annotations

import pytest

from oysterbench_leaderboard.submissions.accounts.rates import DAY_S, WINDOW_S, DailyReads, Sampler, hours_and_minutes
from oysterbench_leaderboard.submissions.reading.refusals import Refusal

OF_ONE, OF_STRANGERS = 10, 30


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_of_many_lines_some_are_written_and_the_others_counted():
    clock = Clock()
    sampler = Sampler(OF_ONE, OF_STRANGERS, clock)
    asked = [sampler.ask("team reef", False) for _ in range(OF_ONE + 5)]
    assert asked == [0] * OF_ONE + [None] * 5
    assert sampler.ask("team kelp", False) == 0, "another one has its own"
    clock.now += WINDOW_S + 1
    assert sampler.ask("team reef", False) == 5
    assert sampler.ask("team reef", False) == 0


def test_ten_thousand_strangers_write_no_more_than_thirty_lines():
    clock = Clock()
    sampler = Sampler(OF_ONE, OF_STRANGERS, clock)
    asked = [sampler.ask(f"10.0.{k // 256}.{k % 256}", True) for k in range(10_000)]
    assert sum(found is not None for found in asked) == OF_STRANGERS
    assert sampler.ask("team reef", False) == 0, "teams are heard all the same"
    clock.now += WINDOW_S + 1
    assert sampler.ask("10.9.9.9", True) == 10_000 - OF_STRANGERS
    assert len(sampler._written) == 2


def test_uploads_of_a_team_are_read_so_often_a_day_and_no_more():
    clock = Clock()
    reads = DailyReads(3, clock)
    for _ in range(3):
        reads.count("reef")
    with pytest.raises(Refusal, match=r"3 uploads in 24 hours.*the next is accepted in 24 h 1 min") as caught:
        reads.count("reef")
    assert (caught.value.kind, caught.value.retry_s) == ("quota", DAY_S + 1)
    reads.count("kelp")
    clock.now += DAY_S + 1
    reads.count("reef")


def test_a_full_day_is_said_before_anything_is_counted():
    reads = DailyReads(1, Clock())
    reads.check("reef")
    reads.check("reef")
    reads.count("reef")
    with pytest.raises(Refusal, match="1 uploads in 24 hours"):
        reads.check("reef")


@pytest.mark.parametrize(
    ("wait_s", "text"),
    [(86_400, "24 h 0 min"), (86_399, "24 h 0 min"), (86_340, "23 h 59 min"), (3601, "1 h 1 min"), (1, "0 h 1 min")],
)
def test_a_time_to_wait_has_no_sixtieth_minute(wait_s, text):
    assert hours_and_minutes(wait_s) == text
