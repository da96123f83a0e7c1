"""A server that is killed at random moments of receiving, checking, scoring and publishing."""

from __future__ import annotations

import pytest

from tests.helpers.kills import check, run


@pytest.mark.slow
def test_two_kills_lose_nothing_and_score_nothing_twice(tmp_path):
    check(run(tmp_path, 2), 2)


@pytest.mark.slow
def test_fifty_kills_lose_nothing_and_score_nothing_twice(tmp_path):
    outcome = run(tmp_path, 50, seed=2)
    check(outcome, 50)
    assert any("running" in stages for stages in outcome.killed_at), "some died while they scored"
    assert outcome.attempts > len(outcome.sent), "some were scored by another server than the one that began"
