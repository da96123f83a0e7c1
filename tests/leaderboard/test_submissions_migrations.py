"""Databases of earlier versions, and of later ones."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import text

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.submissions import database
from oysterbench_leaderboard.submissions.database import SubmissionDatabase
from oysterbench_leaderboard.submissions.settings import SubmissionSettings

BEFORE_STEPS = """
CREATE TABLE teams (name VARCHAR(80) NOT NULL PRIMARY KEY, created VARCHAR(32));
CREATE TABLE tokens (id VARCHAR(16) NOT NULL PRIMARY KEY, team VARCHAR(80) NOT NULL, hash VARCHAR(64) NOT NULL,
  created VARCHAR(32) NOT NULL, revoked VARCHAR(32) NOT NULL);
CREATE TABLE sessions (hash VARCHAR(64) NOT NULL PRIMARY KEY, token VARCHAR(16) NOT NULL, expires FLOAT NOT NULL);
CREATE TABLE events (number INTEGER NOT NULL PRIMARY KEY, at VARCHAR(32) NOT NULL, who VARCHAR(120) NOT NULL,
  what VARCHAR(32) NOT NULL, submission VARCHAR(16) NOT NULL, why TEXT NOT NULL);
CREATE TABLE submissions (id VARCHAR(16) NOT NULL PRIMARY KEY, team VARCHAR(80) NOT NULL, track VARCHAR(32) NOT NULL,
  split VARCHAR(80) NOT NULL, method VARCHAR(80) NOT NULL, url VARCHAR(300) NOT NULL, summary VARCHAR(500) NOT NULL,
  kind VARCHAR(16) NOT NULL, digest VARCHAR(64) NOT NULL, size INTEGER NOT NULL, created VARCHAR(32) NOT NULL,
  created_s FLOAT NOT NULL, updated VARCHAR(32) NOT NULL, state VARCHAR(16) NOT NULL, attempt INTEGER NOT NULL,
  lease FLOAT NOT NULL, reason TEXT NOT NULL, record VARCHAR(64) NOT NULL, published VARCHAR(64) NOT NULL,
  notice VARCHAR(32) NOT NULL, UNIQUE (team, track, split, method, digest));
CREATE INDEX submissions_waiting ON submissions (state, attempt, created_s);
CREATE INDEX submissions_of_team ON submissions (team, created_s);
"""
"""What servers made before there were steps."""

ROWS = """
INSERT INTO teams VALUES ('reef lab', '2026-01-02T03:04:05Z');
INSERT INTO tokens VALUES ('3f9c21ab77e0', 'reef lab', 'ab', '2026-01-02T03:04:05Z', '');
INSERT INTO events (at, who, what, submission, why) VALUES ('2026-01-02T03:04:05Z', 'reef lab', 'queued', '1a', 'carp');
INSERT INTO submissions VALUES ('1a', 'reef lab', 'slam', 'pool-test', 'carp', '', 'a carp', 'poses', 'cd', 12,
  '2026-01-02T03:04:05Z', 1767323045.0, '2026-01-02T03:04:06Z', 'done', 2, 0.0, '', 'ef', '', '');
INSERT INTO submissions VALUES ('1b', 'reef lab', 'slam', 'pool-test', 'tench', '', '', 'poses', 'ce', 13,
  '2026-01-02T03:04:05Z', 1767323046.0, '2026-01-02T03:04:06Z', 'running', 1, 1767323099.0, '', '', '', '');
"""


@pytest.fixture(params=["SQLite", "PostgreSQL"])
def settings(request, tmp_path):
    """Of a server whose database is empty."""
    if request.param == "SQLite":
        return SubmissionSettings(folder=tmp_path)
    url = request.getfixturevalue("postgres")
    import psycopg

    with psycopg.connect(url.replace("+psycopg", ""), autocommit=True) as connection:
        connection.execute("DROP SCHEMA public CASCADE")
        connection.execute("CREATE SCHEMA public")
    return SubmissionSettings(folder=tmp_path, database=url)


def lay(settings: SubmissionSettings, script: str) -> None:
    """Run statements over a database that nobody has opened."""
    if settings.database:
        import psycopg

        with psycopg.connect(settings.database.replace("+psycopg", "")) as connection:
            connection.execute(script.replace("number INTEGER", "number SERIAL"))
        return
    with closing(sqlite3.connect(settings.folder / "submissions.sqlite")) as connection:
        connection.executescript(script)


def differences(opened: SubmissionDatabase) -> list[object]:
    """What the tables have otherwise than the code says."""
    with opened.reading() as connection:
        return compare_metadata(MigrationContext.configure(connection), database.metadata)


def test_a_new_database_has_the_tables_that_the_code_knows(settings):
    with closing(SubmissionDatabase(settings)) as opened:
        assert differences(opened) == []


def test_a_database_from_before_there_were_steps_is_upgraded_with_its_rows(settings):
    lay(settings, BEFORE_STEPS + ROWS)
    for _ in range(2):
        with closing(SubmissionDatabase(settings)) as opened, opened.reading() as connection:
            assert differences(opened) == []
            tench, carp = database.find(connection)
            assert (carp.id, carp.team, carp.method, carp.digest, carp.size) == ("1a", "reef lab", "carp", "cd", 12)
            assert (carp.state, carp.attempt, carp.record, carp.created_s) == ("done", 2, "ef", 1767323045.0)
            assert (tench.id, tench.method, tench.attempt) == ("1b", "tench", 1)
            assert [row["why"] for row in database.log(connection)] == ["carp"]
            assert connection.execute(text("SELECT id, hash FROM tokens")).all() == [("3f9c21ab77e0", "ab")]


def test_a_step_that_fails_leaves_the_database_as_it_was(settings):
    lay(settings, "CREATE TABLE submissions (id INTEGER)")  # which cannot get the index of the first step
    with pytest.raises(ResultError, match="the database of submissions cannot be opened"):
        SubmissionDatabase(settings)
    lay(settings, "DROP TABLE submissions; CREATE TABLE teams (name INTEGER)")  # so no step has left its own


def test_a_database_of_a_later_version_is_refused_in_a_line(settings):
    SubmissionDatabase(settings).close()
    lay(settings, "UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(ResultError, match=r"made by a later version of oysterbench.*9999") as refused:
        SubmissionDatabase(settings)
    assert "\n" not in str(refused.value)
