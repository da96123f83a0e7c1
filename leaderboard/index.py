"""The index of a board: what pages and tables ask, answered from a database that can be made anew from the records."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from oysterbench_leaderboard.board import BoardInfo, BoardPage, Query, Row
from oysterbench_leaderboard.store import RecordStore


class Index(Protocol):
    """What every reader may ask. All answers are of one revision at a time; sequences are in the board's order."""

    store: RecordStore

    @property
    def revision(self) -> str:
        """Changes whenever any answer does: what a cache of pages is keyed by."""

    def rebuild(self, progress: Callable[[int, int], None] | None = None) -> None:
        """Make all anew from the store's records and notices; readers see the old index until the new one is whole."""

    def refresh(self) -> None:
        """Take in records and notices that have come into the store since; ranks only the boards they are on."""

    def boards(self, track: str | None = None) -> list[BoardInfo]:
        """All boards: tracks in order, the newest evaluator of a split first."""

    def find_board(self, track: str, split: str, board: str | None = None) -> BoardInfo:
        """The newest board of a split, or the one with that id. Raises ResultError naming what there is."""

    def page(self, board: str, query: Query) -> BoardPage:
        """Rows of a board."""

    def row(self, digest: str) -> Row:
        """A record's row. Raises ResultError where there is none. A digest may be shortened to 8 digits or more where
        that is unique."""

    def method(self, method: str, team: str | None = None) -> list[Row]:
        """All rows of a method, the newest first, superseded and withdrawn ones too."""

    def methods(self) -> list[tuple[str, str, int]]:
        """Method, team, number of current records."""

    def sequence_means(self, digest: str) -> dict[str, dict[str, float | None]]:
        """Sequence -> metric -> mean over runs, for a record."""
