"""A server of submissions as one file, and back: rows of its database as JSON, and the files that these speak of.

The rows are those of one moment. Files are named by their hash, never changed, and on the disk before a row names them:
so they are copied afterwards, while the server runs. Rows go back into SQLite as well as PostgreSQL, and into a later
version of oysterbench. Estimates in an object store stay there.
"""

from __future__ import annotations

import io
import json
import re
import tarfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from alembic.migration import MigrationContext
from alembic.util.exc import CommandError
from sqlalchemy import Connection, MetaData, insert, inspect, select, text

from oysterbench.core.errors import ResultError
from oysterbench.core.files import appearing
from oysterbench.core.text import in_one_line
from oysterbench.version import VERSION
from oysterbench_leaderboard.database import open_engine
from oysterbench_leaderboard.submissions.database import Database, metadata, sessions
from oysterbench_leaderboard.submissions.migrations import upgrade
from oysterbench_leaderboard.submissions.settings import FILE, SubmissionSettings, load_settings

ABOUT = "backup.json"
PRIVATE = ("estimates/*", "scored/*/*.json", "key", FILE)
PUBLIC = ("records/*.json", "changes/*.json", "curves/*.json")
"""Files of the private folder and of the board's."""

HASH = "[0-9a-f]{64}"
KNOWN = re.compile(
    rf"rows/\w+\.jsonl|private/(key|settings\.toml|estimates/{HASH}|scored/\w+/{HASH}\.json)|board/\w+/{HASH}\.json"
)
BATCH = 1000
"""Rows that are inserted at once."""


@dataclass(frozen=True)
class Backup:
    """What is in a file: rows by table, and how many files."""

    rows: dict[str, int]
    files: int


def backup(settings: SubmissionSettings, file: Path, board: Path | None = None) -> Backup:
    """Write all of a server into a file that only its owner can read. board: folder of records that come along."""
    database = Database(settings)
    rows: Counter[str] = Counter()
    files = 0
    try:
        with appearing(file, mode=0o600) as output, tarfile.open(fileobj=output, mode="w") as archive:
            with database.reading() as connection:
                if connection.dialect.name == "postgresql":
                    connection.execute(text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ"))
                revision = MigrationContext.configure(connection).get_current_revision()
                _add(archive, ABOUT, json.dumps({"oysterbench": VERSION, "revision": revision}).encode())
                for table in metadata.sorted_tables:
                    if table is sessions:
                        continue
                    found = connection.execute(select(table).order_by(*table.primary_key)).mappings()
                    lines = [json.dumps(dict(row)) for row in found]
                    rows[table.name] = len(lines)
                    _add(archive, f"rows/{table.name}.jsonl", "\n".join(lines).encode())
            for name, path in _files(settings.folder, board):
                archive.add(path, name)
                files += 1
    finally:
        database.close()
    return Backup(dict(rows), files)


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    archive.addfile(entry, io.BytesIO(data))


def _files(folder: Path, board: Path | None) -> Iterator[tuple[str, Path]]:
    """Name in the archive, and where it is. What is being written has other names and is passed over."""
    for prefix, root, patterns in (("private", folder, PRIVATE), ("board", board or Path(), PUBLIC if board else ())):
        for path in (path for pattern in patterns for path in sorted(root.glob(pattern))):
            name = f"{prefix}/{path.relative_to(root).as_posix()}"
            if KNOWN.fullmatch(name):
                yield name, path


def restore(file: Path, folder: Path, board: Path | None = None) -> Backup:
    """Make a private folder, its database, and where it is named the board's folder, of a backup. The folder may hold a
    settings.toml alone, which then counts instead of the old one. Raises ResultError where one of them is not empty,
    and where the file is none of ours or is damaged."""
    for place in (folder, *([board] if board else [])):
        if place.exists() and any(path.name != FILE for path in place.iterdir()):
            raise ResultError(f"{place}: expected an empty or new folder to restore into; nothing was changed")
    try:
        with tarfile.open(file) as archive:
            return _restore(archive, folder, board)
    except (tarfile.TarError, KeyError, EOFError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ResultError(
            f"{file}: cannot be restored: the backup is damaged, or none of oysterbench ({in_one_line(error, 100)}); "
            f"empty {folder}, and restore another one"
        ) from None
    except (OSError, ValueError, CommandError) as error:
        raise ResultError(
            f"{file}: cannot be restored: {in_one_line(error)}; empty {folder} before you try again"
        ) from None


def _restore(archive: tarfile.TarFile, folder: Path, board: Path | None) -> Backup:
    entries = archive.getmembers()
    about = json.loads(_read(archive, ABOUT))
    tables = {}
    files = 0
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o700)
    for entry in entries[1:]:
        if not entry.isfile() or not KNOWN.fullmatch(entry.name):
            raise ValueError(f"{entry.name!r} is not part of a backup")
        root, _, name = entry.name.partition("/")
        if root == "rows":
            tables[name.removesuffix(".jsonl")] = _read(archive, entry.name).splitlines()
            continue
        place = folder if root == "private" else board
        if place is None or (name == FILE and (folder / FILE).exists()):
            continue
        _extract(archive, entry, place / name, secret=root == "private")
        files += 1
    engine = open_engine(load_settings(folder).url)
    try:
        with engine.execution_options(writes=True).begin() as connection:
            if inspect(connection).get_table_names():
                raise ValueError("its database holds tables already")
            upgrade(connection, about["revision"])
            _insert(connection, tables)
            upgrade(connection)
    finally:
        engine.dispose()
    return Backup({name: len(lines) for name, lines in tables.items()}, files)


def _insert(connection: Connection, tables: dict[str, list[bytes]]) -> None:
    """Rows, by the columns that the tables had then."""
    then = MetaData()
    then.reflect(connection)
    for name, lines in tables.items():
        rows: list[dict[str, Any]] = [json.loads(line) for line in lines]
        for row in rows if name == "events" else ():
            del row["number"]  # which the database gives anew, in the same order
        for k in range(0, len(rows), BATCH):
            connection.execute(insert(then.tables[name]), rows[k : k + BATCH])


def _read(archive: tarfile.TarFile, name: str) -> bytes:
    opened = archive.extractfile(name)
    return opened.read() if opened else b""


def _extract(archive: tarfile.TarFile, entry: tarfile.TarInfo, target: Path, secret: bool) -> None:
    """A file, whose bytes are those that it is named for."""
    found = sha256()
    source = archive.extractfile(entry)
    with appearing(target, mode=0o600 if secret else 0o644) as output:
        while chunk := source.read(1 << 20) if source else b"":
            found.update(chunk)
            output.write(chunk)
    if re.fullmatch(HASH, target.stem) and target.stem != found.hexdigest():
        raise ValueError(f"{entry.name} is damaged: its SHA-256 is {found.hexdigest()}")
