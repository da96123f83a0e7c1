"""Settings of a server that takes submissions: where it keeps them, and how much of anything it takes."""

from __future__ import annotations

import re
import tomllib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from oysterbench.core.errors import ResultError

FILE = "settings.toml"
"""In the private folder: any of the keys below but `folder`."""

MB = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a server allows. Sizes in bytes, times in seconds.

    folder:             private: the database, estimates, records that are not published, the log. Never served
    database:           SQLAlchemy URL; empty for SQLite in `folder`
    file_bytes, upload_bytes: of one file (also inside an archive), and of a whole submission
    results_bytes:      of a results.json
    entries:            files in an archive, those of its .npz files included
    unpacked_bytes:     of all that an archive holds
    ratio:              of an entry's size to what it takes in the archive. Images compress hundreds of times as arrays,
                        so .npz files are held by `unpacked_bytes` alone
    per_day, per_split: submissions that are accepted of a team in 24 hours, and of a team on one split in all
    uploads_at_once, checks_at_once: of all clients
    idle_s:             after which a client that sends nothing is sent away; upload_s: an upload takes at most
    workers:            submissions scored at once
    lease_s:            a worker that is not heard of for so long has died, and another one takes over
    check_wall_s, check_cpu_s, score_wall_s, score_cpu_s: of the limited process
    memory_bytes:       address space of the limited process
    attempts:           how often a process that ends without an answer is tried again, in all
    guesses_of_address, guesses: wrong tokens in `guess_window_s`, of one address and of all
    session_s:          how long a sign-in to the web form lasts
    """

    folder: Path
    database: str = ""
    file_bytes: int = 64 * MB
    upload_bytes: int = 256 * MB
    results_bytes: int = 4 * MB
    entries: int = 20_000
    unpacked_bytes: int = 1000 * MB
    ratio: float = 100.0
    per_day: int = 10
    per_split: int = 100
    uploads_at_once: int = 8
    checks_at_once: int = 2
    idle_s: float = 30.0
    upload_s: float = 3600.0
    workers: int = 1
    lease_s: float = 30.0
    check_wall_s: float = 120.0
    check_cpu_s: int = 90
    score_wall_s: float = 1800.0
    score_cpu_s: int = 1500
    memory_bytes: int = 4000 * MB
    attempts: int = 3
    guesses_of_address: int = 10
    guesses: int = 200
    guess_window_s: float = 60.0
    session_s: float = 12 * 3600.0

    def __post_init__(self) -> None:
        for key, value in asdict(self).items():
            if isinstance(value, int | float) and not value > 0:
                raise ResultError(f"{FILE}: key {key!r}: expected more than 0, got {value!r}")

    @property
    def url(self) -> str:
        """Of the database."""
        if not self.database:
            return f"sqlite:///{self.folder / 'submissions.sqlite'}"
        return re.sub(r"^postgres(ql)?://", "postgresql+psycopg://", self.database)


def load_settings(folder: Path, **changes: Any) -> Settings:
    """The settings of a private folder: its settings.toml, and `changes` over it. Raises ResultError naming the key."""
    path, found = folder / FILE, {}
    if path.is_file():
        try:
            found = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ResultError(f"{path}: not valid TOML: {error}") from None
    kinds = {f.name: f.default for f in fields(Settings) if f.name != "folder"}
    for key, value in found.items():
        if key not in kinds:
            raise ResultError(f"{path}: unknown key {key!r}; known keys: {', '.join(kinds)}")
        allowed: Any = (int, float) if isinstance(kinds[key], float) else type(kinds[key])
        if not isinstance(value, allowed) or isinstance(value, bool):
            raise ResultError(f"{path}: key {key!r}: expected a value like {kinds[key]!r}, got {value!r}")
    return Settings(folder=folder, **{**found, **changes})
