"""Where the records and their index are, as every leaderboard command needs to know."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oysterbench.core.errors import ResultError

if TYPE_CHECKING:
    from oysterbench_leaderboard.boards.board import BoardReader
    from oysterbench_leaderboard.boards.index import BoardIndex
    from oysterbench_leaderboard.storage.store import RecordStore


DAMAGED = 3
"""Exit code of commands that have found a damaged file, as for all damaged data."""


@dataclass(frozen=True)
class Place:
    """Place of a board. folder: of the records, by default `OYSTERBENCH_BOARD`, or those shipped with oysterbench; url:
    of the index, by default a file in the home folder."""

    folder: Path | None = None
    url: str | None = None

    @property
    def path(self) -> Path:
        """Folder of the records."""
        if self.folder is not None:
            return self.folder
        chosen = os.environ.get("OYSTERBENCH_BOARD")
        return Path(chosen) if chosen else Path(str(resources.files("oysterbench_leaderboard")))

    def store(self, must_exist: bool = True) -> RecordStore:
        """Store of the records. Raises ResultError where its folder does not exist, unless `must_exist` is False."""
        from oysterbench_leaderboard.storage.store import RecordStore

        if must_exist and not self.path.is_dir():
            raise ResultError(f"{self.path}: no such folder; `oysterbench leaderboard add` makes a board")
        return RecordStore(self.path)

    def index(self) -> BoardIndex:
        """Open the index and bring it up to date."""
        from oysterbench_leaderboard.boards.index import open_index

        return open_index(self.store(), self.url)

    def reader(self) -> BoardReader:
        """Reader of the board: the index or, where its library is not installed, the records themselves."""
        if self.url is not None or find_spec("sqlalchemy") is not None:
            return self.index()
        from oysterbench_leaderboard.boards.memory import MemoryIndex

        return MemoryIndex(self.store())


def find_place(context: Any) -> Place:
    """Place given to the command's group; the default one without any."""
    return context.obj if isinstance(context.obj, Place) else Place()
