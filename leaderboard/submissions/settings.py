"""Settings of a server that takes submissions: where it keeps them, and its limits."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any

import msgspec

from oysterbench.core.errors import ResultError
from oysterbench.core.names import listed
from oysterbench_leaderboard.submissions.reading.archive import Limits

FILE = "settings.toml"
"""File in the private folder, with any of the keys below except `folder`."""

OWN = re.compile(
    r"submissions\.sqlite.*|settings\.toml|key|estimates|scored|incoming|catalogue|private\.log.*|\..*|lost\+found"
)
"""Names in the private folder of a server, or of no matter."""

MB = 1_000_000

Count = Annotated[int, msgspec.Meta(gt=0)]
Seconds = Annotated[float, msgspec.Meta(gt=0)]


class SubmissionSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits and places of a server. Sizes in bytes, times in seconds.

    folder:             private, never served: the database, estimates, unpublished records, the log
    database:           SQLAlchemy URL; empty for SQLite in `folder`
    estimates:          place of the uploads: a folder, or a URL of a store that fsspec knows (s3://bucket/estimates);
                        empty for `estimates` in `folder`
    file_bytes, upload_bytes: size of one file (also inside an archive), and of a whole submission
    results_bytes:      size of a results.json
    entries:            files in an archive, including those of its .npz files
    unpacked_bytes:     unpacked size of all that an archive holds
    ratio:              compression ratio of an archive's entry. Images as arrays compress by a factor of hundreds, so
                        .npz files are limited by `unpacked_bytes` alone
    lines:              of a text file: 120 000 are poses of 10 min at 200 Hz
    annotations:        of one image, in COCO annotations
    reads_per_day:      uploads of a team that are received in 24 hours, including those refused or too slow; by one
                        server since its start
    per_day, per_split: submissions accepted from a team in 24 hours, and from a team on one split in all
    uploads_at_once, checks_at_once: from all clients; uploads_of_team, uploads_of_address: from one
    upload_safe_s:      a team's time in places for uploads (`places`) after which, when all places are taken, it gives
                        way to a team that has had less
    idle_s:             after which a client that sends nothing is disconnected, and longest time of a small form, such
                        as a sign-in; upload_s: longest time of an upload
    upload_grace_s, upload_bytes_per_s: after the grace time, an upload must keep up with this rate: a client that
                        trickles loses its place among `uploads_at_once`
    workers:            submissions scored at once, without a cluster
    scheduler:          address of the Dask scheduler whose workers score; empty for this machine
    check_wall_s, check_cpu_s, score_wall_s, score_cpu_s: wall-clock and processor time of the sandbox
    check_memory_bytes, memory_bytes: address space of the sandbox, for reading an upload and for scoring it
    needs_namespaces:   whether to refuse to start where the sandbox cannot have its own namespaces, instead of doing
                        without
    attempts:           total number of attempts for a process that ends without an answer
    guesses_of_address, guesses: wrong tokens in `guess_window_s`, from one address and from all
    refusals_of_one, refusals_of_strangers: logged per minute, for a team or address, and for all addresses
    session_s:          how long a sign-in to the web form lasts
    """

    folder: Path
    database: str = ""
    estimates: str = ""
    file_bytes: Count = 64 * MB
    upload_bytes: Count = 256 * MB
    results_bytes: Count = 4 * MB
    entries: Count = 20_000
    unpacked_bytes: Count = 1000 * MB
    ratio: Annotated[float, msgspec.Meta(gt=0)] = 100.0
    lines: Count = 120_000
    annotations: Count = 5000
    reads_per_day: Count = 60
    per_day: Count = 10
    per_split: Count = 100
    uploads_at_once: Count = 8
    uploads_of_team: Count = 1
    uploads_of_address: Count = 4
    upload_safe_s: Annotated[float, msgspec.Meta(ge=0)] = 600.0
    checks_at_once: Count = 2
    idle_s: Seconds = 30.0
    upload_s: Seconds = 3600.0
    upload_grace_s: Seconds = 60.0
    upload_bytes_per_s: Count = 64_000
    workers: Count = 1
    scheduler: str = ""
    check_wall_s: Seconds = 120.0
    check_cpu_s: Count = 90
    score_wall_s: Seconds = 1800.0
    score_cpu_s: Count = 1500
    check_memory_bytes: Count = 1500 * MB
    memory_bytes: Count = 4000 * MB
    needs_namespaces: bool = False
    attempts: Count = 3
    guesses_of_address: Count = 10
    guesses: Count = 200
    guess_window_s: Seconds = 60.0
    refusals_of_one: Count = 10
    refusals_of_strangers: Count = 30
    session_s: Seconds = 12 * 3600.0

    @property
    def url(self) -> str:
        """SQLAlchemy URL of the database."""
        if not self.database:
            return f"sqlite:///{self.folder / 'submissions.sqlite'}"
        return re.sub(r"^postgres(ql)?://", "postgresql+psycopg://", self.database)

    @property
    def place(self) -> str:
        """Place of the uploads: a path that is absolute if `folder` is, or a URL."""
        return self.estimates if "://" in self.estimates else str(self.folder / (self.estimates or "estimates"))

    @property
    def limits(self) -> Limits:
        """Limits on what is read from an upload."""
        return Limits(**{key: getattr(self, key) for key in Limits.__dataclass_fields__})


def is_server(folder: Path) -> bool:
    """Whether a folder holds anything that only the private one of a server does."""
    return any((folder / name).exists() for name in ("submissions.sqlite", "key", FILE))


def has_database(folder: Path) -> bool:
    """Whether a folder is the private one of a server whose database is there already: in it, or named by its
    settings.toml. One that cannot be read counts, so that `load_settings` says what is wrong with it."""
    if (folder / "submissions.sqlite").is_file():
        return True
    try:
        return bool(tomllib.loads((folder / FILE).read_text(encoding="utf-8")).get("database"))
    except FileNotFoundError:
        return False
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        return True


def check_own(settings: SubmissionSettings) -> None:
    """Raise ResultError where the private folder is somebody's else: it would be closed to all others."""
    folder = settings.folder
    if settings.database or not folder.is_dir() or has_database(folder):
        return
    others = sorted(path.name for path in folder.iterdir() if not OWN.fullmatch(path.name))
    if others:
        raise ResultError(
            f"{folder}: expected a new or empty folder, or that of a server, got one with {listed(others[:5])}; it was "
            "left unchanged: name a folder for the server alone"
        )


def load_settings(folder: Path, **changes: Any) -> SubmissionSettings:
    """Load the settings of a private folder: its settings.toml, overridden by `changes`. Raises ResultError naming the
    key."""
    path, found = folder / FILE, {}
    try:
        if path.is_file():
            found = tomllib.loads(path.read_text(encoding="utf-8"))
        # Absolute, because readers of uploads run in a folder of their own.
        return msgspec.convert({**found, **changes, "folder": folder.absolute()}, SubmissionSettings)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ResultError(f"{path}: not valid TOML: {error}") from None
    except msgspec.ValidationError as error:
        known = ", ".join(key for key in SubmissionSettings.__struct_fields__ if key != "folder")
        raise ResultError(f"{path}: {error}; known keys: {known}") from None
