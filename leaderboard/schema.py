"""The tables of the index, alike in SQLite and PostgreSQL."""

from __future__ import annotations

from sqlalchemy import Boolean, Column, Float, Index, Integer, MetaData, Table, Text

from oysterbench_leaderboard.intake import MOST_COLUMNS

SCHEMA = "4"
"""Rises with every change of a table, or of what is put into it: an index of another is made anew."""

METADATA = MetaData()
_TEXT = Text().with_variant(Text(collation="C"), "postgresql")  # SQLite's order: by bytes, whatever the locale


META = Table("oysterbench_meta", METADATA, Column("key", _TEXT, primary_key=True), Column("value", _TEXT))
"""`schema`, `revision`, and `notices`, a hash of all of them."""

BOARDS = Table(
    "oysterbench_boards",
    METADATA,
    Column("id", _TEXT, primary_key=True),
    Column("position", Integer),
    Column("track", _TEXT),
    Column("split", _TEXT),
    Column("split_digest", _TEXT),
    Column("evaluator_version", _TEXT),
    Column("settings", _TEXT),
    Column("metric", _TEXT),
    Column("sequences", _TEXT),
    Column("entries", Integer),
    Column("updated", _TEXT),
    Column("newest", Boolean),
)
"""`board.BoardInfo`; settings and sequences as JSON."""

ROWS = Table(
    "oysterbench_rows",
    METADATA,
    Column("digest", _TEXT, primary_key=True),
    Column("board", _TEXT),
    Column("position", Integer),
    *(
        Column(key, _TEXT)
        for key in ("method", "team", "words", "tier", "url", "summary", "created", "supersedes", "state")
    ),
    Column("place", Integer),
    Column("rank", Integer),
    *(Column(key, Float(53)) for key in ("score", "low", "high", "data_set", "coverage")),
    *(Column(key, Integer) for key in ("sequences", "runs", "failures")),
    *(Column(f"m{i}", Float(53)) for i in range(MOST_COLUMNS)),
    Index("oysterbench_rows_in_order", "board", "position"),
    Index("oysterbench_rows_of_method", "method", "team"),
    Index("oysterbench_rows_superseding", "supersedes"),
)
"""`board.Row`. words: method and team, for searching; m0, m1, ...: `intake.COLUMNS` of the track, in their order."""

ANSWERS = Table("oysterbench_answers", METADATA, Column("digest", _TEXT, primary_key=True), Column("data", _TEXT))
"""`intake.Kept` as JSON: what a board is ranked by again when a record joins it."""

PROBLEMS = Table("oysterbench_problems", METADATA, Column("file", _TEXT, primary_key=True), Column("reason", _TEXT))
"""Files that were left out, and why."""
