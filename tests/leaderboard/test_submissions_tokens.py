"""Tokens of teams: kept as hashes, revoked, and guesses counted."""

from __future__ import annotations

import pytest
from sqlalchemy import insert

from oysterbench.core.errors import ResultError
from oysterbench.hub.addresses import network
from oysterbench_leaderboard.submissions.accounts.tokens import Guesses, issue, listed, recognise, revoke
from oysterbench_leaderboard.submissions.database import SubmissionDatabase, teams
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.settings import SubmissionSettings


def test_a_token_is_shown_once_and_only_its_hash_is_kept(tmp_path):
    database = SubmissionDatabase(SubmissionSettings(folder=tmp_path / "private"))
    one, two = issue(database, "reef lab"), issue(database, "reef lab", "keep")
    assert one != two
    with database.reading() as connection:
        assert recognise(connection, one).team == recognise(connection, two).team == "reef lab"
        for wrong in (one[:-1], one + "x", one.replace("oyb", "oya"), one.upper(), "", "oyb__", "x" * 10_000):
            assert recognise(connection, wrong) is None
    kept = b"".join(path.read_bytes() for path in (tmp_path / "private").iterdir())
    assert one.split("_", 2)[2].encode() not in kept
    assert (tmp_path / "private").stat().st_mode & 0o77 == 0
    assert [row["team"] for row in listed(database)] == ["reef lab", "reef lab"]
    database.close()


def test_tokens_are_revoked_one_by_one_or_with_their_team(tmp_path):
    database = SubmissionDatabase(SubmissionSettings(folder=tmp_path))
    one, two = issue(database, "reef lab"), issue(database, "reef lab", "keep")
    assert revoke(database, one.split("_")[1]) == [one.split("_")[1]]
    with database.reading() as connection:
        assert recognise(connection, one) is None
        assert recognise(connection, two) is not None
    assert revoke(database, "reef lab") == [two.split("_")[1]]
    with database.reading() as connection:
        assert recognise(connection, two) is None
    with pytest.raises(ResultError, match="no team and no token is named 'nobody'"):
        revoke(database, "nobody")
    database.close()


def test_a_team_is_one_in_whatever_unicode_form_its_name_is_typed(tmp_path):
    database = SubmissionDatabase(SubmissionSettings(folder=tmp_path))
    issue(database, "Te\u0301am")
    with pytest.raises(ResultError, match="has a token already"):
        issue(database, "T\u00e9am")
    issue(database, "Te\u0301am", "keep")
    assert [row["team"] for row in listed(database)] == ["T\u00e9am", "T\u00e9am"]
    assert len(revoke(database, "Te\u0301am")) == 2
    database.close()


@pytest.mark.parametrize("name", ["", " x", "a\nb", "x" * 81])
def test_a_team_has_a_plain_name(tmp_path, name):
    database = SubmissionDatabase(SubmissionSettings(folder=tmp_path))
    with pytest.raises(ResultError):
        issue(database, name)
    database.close()


def test_guesses_are_counted_by_address_and_all_together(tmp_path):
    guesses = Guesses(SubmissionSettings(folder=tmp_path, guesses_of_address=3, guesses=5))
    for _ in range(3):
        guesses.check("10.0.0.1")
        guesses.failed("10.0.0.1")
    with pytest.raises(Refusal, match="too many wrong tokens"):
        guesses.check("10.0.0.1")
    guesses.check("10.0.0.2")
    guesses.failed("10.0.0.2")
    guesses.failed("2001:db8::1")
    with pytest.raises(Refusal):
        guesses.check("10.0.0.2")
    with pytest.raises(Refusal):
        guesses.check("2001:db8::ffff")  # of the same network
    guesses.check("10.0.0.3")  # has never sent a wrong one
    assert network("::ffff:10.0.0.1") == "10.0.0.1"


def test_a_second_token_is_made_only_where_it_is_said_what_becomes_of_the_first(tmp_path):
    database = SubmissionDatabase(SubmissionSettings(folder=tmp_path))
    first = issue(database, "reef lab")
    why = r"has a token already \([0-9a-f]{12} of 20.*--replace to revoke it .*--another for one more; nothing was"
    with pytest.raises(ResultError, match=why):
        issue(database, "reef lab")
    assert len(listed(database)) == 1
    second = issue(database, "reef lab", "revoke")
    with database.reading() as connection:
        assert recognise(connection, first) is None
        assert recognise(connection, second) is not None
    assert revoke(database, "reef lab") == [second.split("_")[1]]
    assert issue(database, "reef lab"), "none is valid any more"
    database.close()


TWINS = ["Reef Lab 10", "reeflab 10", "r\N{LATIN SMALL LETTER E WITH ACUTE}ef lab 10", "reef-lab_10!", "reef lab lO"]


@pytest.mark.parametrize("twin", [*TWINS, "reef Iab I0"])
def test_a_name_that_looks_like_a_teams_is_refused_with_that_teams(tmp_path, twin):
    database = SubmissionDatabase(SubmissionSettings(folder=tmp_path))
    issue(database, "reef lab 10")
    with pytest.raises(ResultError, match="looks like 'reef lab 10', a team that there is"):
        issue(database, twin)
    issue(database, "reef lab 11 b")
    assert [row["team"] for row in listed(database)] == ["reef lab 10", "reef lab 11 b"]
    database.close()


def test_two_spaces_in_a_name_are_refused_but_of_a_team_that_has_them(tmp_path):
    database = SubmissionDatabase(SubmissionSettings(folder=tmp_path))
    with pytest.raises(ResultError, match="'reef  lab': expected single spaces in the name of a team, got two"):
        issue(database, "reef  lab")
    with database.writing() as connection:
        for name in ("reef  lab", "Reef lab"):
            connection.execute(insert(teams).values(name=name, created="2026-01-01T00:00:00Z"))
    for name in ("reef  lab", "Reef lab"):
        assert issue(database, name), "of before there was this rule"
    database.close()
