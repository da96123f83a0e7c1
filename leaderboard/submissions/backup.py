"""Backup of a submission server into one file, and restore: its database rows as JSON, and the files they refer to.

The rows are a snapshot of one moment. Files are named by their hash, never changed, and on disk before a row names
them, so they can be copied afterwards while the server runs. Rows can be restored into SQLite or PostgreSQL, and into a
later version of oysterbench. Estimates in an object store stay there.
"""

from __future__ import annotations

import io
import json
import os
import re
import tarfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

from alembic.migration import MigrationContext
from alembic.util.exc import CommandError
from sqlalchemy import Connection, MetaData, insert, inspect, select, text

from oysterbench.core.atomic import appearing
from oysterbench.core.errors import ResultError
from oysterbench.core.text import in_one_line
from oysterbench.version import VERSION
from oysterbench_leaderboard.boards.database import open_engine
from oysterbench_leaderboard.submissions.database import SubmissionDatabase, metadata, sessions, submissions
from oysterbench_leaderboard.submissions.estimates import Estimates, Upload
from oysterbench_leaderboard.submissions.migrations import upgrade
from oysterbench_leaderboard.submissions.settings import FILE, SubmissionSettings, load_settings

ABOUT, END = "backup.json", "end.json"
"""First and last member of the archive. Without END, an archive that was cut off between two files looks whole."""
PRIVATE = (FILE, "key", "scored/*/*.json")
PUBLIC = ("records/*.json", "changes/*.json", "curves/*.json")
"""Files of the board's folder that are backed up; PRIVATE are those of the private folder."""

RECORDS = "board/records/"

HASH = "[0-9a-f]{64}"
KNOWN = re.compile(
    rf"rows/\w+\.jsonl|private/(key|settings\.toml|estimates/{HASH}|scored/\w+/{HASH}\.json)|board/\w+/{HASH}\.json"
)
BATCH = 1000
"""Number of rows per insert."""


@dataclass(frozen=True)
class Backup:
    """Contents of a backup: the number of rows of each table, of files, and of the board's records among them; damaged:
    paths of files that it lacks, as they are damaged or not there, and what is wrong with each."""

    rows: dict[str, int]
    files: int
    records: int
    damaged: dict[str, str] = field(default_factory=dict)


def backup(settings: SubmissionSettings, file: Path, board: Path | None = None) -> Backup:
    """Write a whole server into a file that only its owner can read. board: folder of records to include. Files that
    are damaged or cannot be read are left out: with one of them, nothing could be restored. Raises ResultError where
    the folder is no board's, before anything is written."""
    if board is not None and not (board / "records").is_dir():
        raise ResultError(
            f"--board {board}: expected the folder of a board, got {'one' if board.is_dir() else 'none'} without "
            "records; nothing was written: name that of `oysterbench leaderboard serve`"
        )
    database = SubmissionDatabase(settings)
    rows: Counter[str] = Counter()
    files = records = 0
    damaged: dict[str, str] = {}
    estimates = Estimates(settings.place).folder
    try:
        with appearing(file, mode=0o600) as output, tarfile.open(fileobj=output, mode="w", dereference=True) as archive:
            with database.reading() as connection:
                if connection.dialect.name == "postgresql":
                    connection.execute(text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ"))
                revision = MigrationContext.configure(connection).get_current_revision()
                _add(archive, ABOUT, json.dumps({"oysterbench": VERSION, "revision": revision}).encode())
                for table in metadata.sorted_tables:
                    if table is sessions:
                        continue
                    found = connection.execute(select(table).order_by(*table.primary_key)).mappings().all()
                    lines = [json.dumps(dict(row)) for row in found]
                    rows[table.name] = len(lines)
                    if table is submissions and estimates:
                        named = sorted({estimates / row["digest"] for row in found})
                        damaged |= {str(path): "it is not there" for path in named if not os.path.lexists(path)}
                    _add(archive, f"rows/{table.name}.jsonl", "\n".join(lines).encode())
            for name, path in _files(settings, board):
                if wrong := _fault(path):
                    damaged[str(path)] = wrong
                    continue
                archive.add(path, name)
                files += 1
                records += name.startswith(RECORDS)
            _add(archive, END, json.dumps({"members": len(archive.getmembers()) + 1}).encode())
    finally:
        database.close()
    return Backup(dict(rows), files, records, damaged)


def _fault(path: Path) -> str:
    """What is wrong with a file: it cannot be read, or its bytes do not match its name, if that is a SHA-256; empty
    where nothing is."""
    try:
        with open(path, "rb") as file:
            digest = file_digest(file, "sha256").hexdigest()
    except OSError as error:
        return f"it cannot be read: {error.strerror}"
    return "its bytes do not match its name" if re.fullmatch(HASH, path.stem) and digest != path.stem else ""


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    archive.addfile(entry, io.BytesIO(data))


def _files(settings: SubmissionSettings, board: Path | None) -> Iterator[tuple[str, Path]]:
    """Yield the archive name and path of each file, the settings first, since they say where the estimates are. Files
    still being written have other names and are skipped."""
    groups: list[tuple[str, Path | None, tuple[str, ...]]] = [
        ("private", settings.folder, PRIVATE),
        ("private/estimates", Estimates(settings.place).folder, ("*",)),
        ("board", board, PUBLIC),
    ]
    for prefix, root, patterns in groups:
        for path in (path for pattern in patterns for path in sorted(root.glob(pattern) if root else ())):
            name = f"{prefix}/{path.relative_to(root or path).as_posix()}"
            if KNOWN.fullmatch(name):
                yield name, path


def restore(file: Path, folder: Path, board: Path | None = None) -> Backup:
    """Restore the private folder, its database and, if given, the board's folder from a backup. Either folder may hold
    a settings.toml and nothing else; that of the private folder then replaces the old one. Raises ResultError where one
    of them is not empty, or where the file is damaged or not a backup of oysterbench."""
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
    if entries[-1].name != END or json.loads(_read(archive, END))["members"] != len(entries):
        raise tarfile.ReadError("it was cut off")
    tables = {}
    files = records = 0
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o700)
    for entry in entries[1:-1]:
        if not entry.isfile() or not KNOWN.fullmatch(entry.name):
            raise ValueError(f"{entry.name!r} is not part of a backup")
        root, _, name = entry.name.partition("/")
        if root == "rows":
            tables[name.removesuffix(".jsonl")] = _read(archive, entry.name).splitlines()
            continue
        place = folder if root == "private" else board
        if place is None or (name == FILE and (folder / FILE).exists()):
            continue
        files += 1
        records += entry.name.startswith(RECORDS)
        kind, _, digest = name.partition("/")
        if root == "private" and kind == "estimates":  # where the settings, which come before them, want them
            _extract(archive, entry, folder / digest, secret=True)
            Estimates(load_settings(folder).place).keep(Upload(folder / digest, digest, entry.size))
            continue
        _extract(archive, entry, place / name, secret=root == "private")
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
    return Backup({name: len(lines) for name, lines in tables.items()}, files, records)


def _insert(connection: Connection, tables: dict[str, list[bytes]]) -> None:
    """Insert rows into the tables as they were at the backup's revision."""
    then = MetaData()
    then.reflect(connection)
    for name, lines in tables.items():
        rows: list[dict[str, Any]] = [json.loads(line) for line in lines]
        for row in rows if name == "events" else ():
            del row["number"]  # the database numbers them anew, in the same order
        for k in range(0, len(rows), BATCH):
            connection.execute(insert(then.tables[name]), rows[k : k + BATCH])


def _read(archive: tarfile.TarFile, name: str) -> bytes:
    opened = archive.extractfile(name)
    return opened.read() if opened else b""


def _extract(archive: tarfile.TarFile, entry: tarfile.TarInfo, target: Path, secret: bool) -> None:
    """Extract a file. Raises ValueError where its name is a SHA-256 that does not match its bytes."""
    found = sha256()
    source = archive.extractfile(entry)
    with appearing(target, mode=0o600 if secret else 0o666) as output:
        while chunk := source.read(1 << 20) if source else b"":
            found.update(chunk)
            output.write(chunk)
    if re.fullmatch(HASH, target.stem) and target.stem != found.hexdigest():
        raise ValueError(f"{entry.name} is damaged: its SHA-256 is {found.hexdigest()}")
