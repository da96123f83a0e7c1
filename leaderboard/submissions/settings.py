"""SubmissionSettings of a server that takes submissions: where it keeps them, and how much of anything it takes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any

import msgspec

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.submissions.archive import Limits

FILE = "settings.toml"
"""In the private folder: any of the keys below but `folder`."""

MB = 1_000_000

Count = Annotated[int, msgspec.Meta(gt=0)]
Seconds = Annotated[float, msgspec.Meta(gt=0)]


class SubmissionSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a server allows. Sizes in bytes, times in seconds.

    folder:             private: the database, estimates, records that are not published, the log. Never served
    database:           SQLAlchemy URL; empty for SQLite in `folder`
    estimates:          what was sent: a folder, or a URL of a store that fsspec knows (s3://bucket/estimates); empty
                        for `estimates` in `folder`
    file_bytes, upload_bytes: of one file (also inside an archive), and of a whole submission
    results_bytes:      of a results.json
    entries:            files in an archive, those of its .npz files included
    unpacked_bytes:     of all that an archive holds
    ratio:              of an entry's size to what it takes in the archive. Images compress hundreds of times as arrays,
                        so .npz files are held by `unpacked_bytes` alone
    lines:              of a file of text: 120 000 are poses of 10 min at 200 Hz
    annotations:        of an image, in COCO annotations
    reads_per_day:      uploads of a team that are read in 24 hours, those that are refused or came too slowly included
    per_day, per_split: submissions that are accepted of a team in 24 hours, and of a team on one split in all
    uploads_at_once, checks_at_once: of all clients; uploads_of_team, uploads_of_address: of one
    upload_safe_s:      of a team's time in places for uploads (`places`); then it gives way to who has had less, where
                        all places are taken
    idle_s:             after which a client that sends nothing is sent away; upload_s: an upload takes at most
    upload_grace_s, upload_bytes_per_s: seconds after which what has come of an upload must be as much as a line of this
                        rate would have brought since: whoever trickles holds a place among `uploads_at_once` no longer
    workers:            submissions scored at once, where no cluster does it
    scheduler:          address of the Dask scheduler whose workers score; empty for this machine
    check_wall_s, check_cpu_s, score_wall_s, score_cpu_s: of the sandbox
    check_memory_bytes, memory_bytes: address space of the sandbox, for reading what was sent and for scoring it
    needs_namespaces:   whether to refuse to start where the sandbox can have none of its own, instead of doing without
    attempts:           how often a process that ends without an answer is tried again, in all
    guesses_of_address, guesses: wrong tokens in `guess_window_s`, of one address and of all
    refusals_of_one, refusals_of_strangers: that are logged in a minute, of a team or address, and of all addresses
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
        """Of the database."""
        if not self.database:
            return f"sqlite:///{self.folder / 'submissions.sqlite'}"
        return re.sub(r"^postgres(ql)?://", "postgresql+psycopg://", self.database)

    @property
    def place(self) -> str:
        """Of what was sent: as absolute as `folder`, or a URL."""
        return self.estimates if "://" in self.estimates else str(self.folder / (self.estimates or "estimates"))

    @property
    def limits(self) -> Limits:
        """Of what is read."""
        return Limits(**{key: getattr(self, key) for key in Limits.__dataclass_fields__})


def load_settings(folder: Path, **changes: Any) -> SubmissionSettings:
    """The settings of a private folder: its settings.toml, and `changes` over it. Raises ResultError naming the key."""
    path, found = folder / FILE, {}
    try:
        if path.is_file():
            found = tomllib.loads(path.read_text(encoding="utf-8"))
        # Absolute, as what reads uploads works in a folder of its own.
        return msgspec.convert({**found, **changes, "folder": folder.absolute()}, SubmissionSettings)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ResultError(f"{path}: not valid TOML: {error}") from None
    except msgspec.ValidationError as error:
        known = ", ".join(key for key in SubmissionSettings.__struct_fields__ if key != "folder")
        raise ResultError(f"{path}: {error}; known keys: {known}") from None
