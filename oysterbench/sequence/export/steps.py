"""How far an export has come: a format says what it will write, and counts it while it writes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from oysterbench.core.room import Room
from oysterbench.sequence.types import Sequence

T = TypeVar("T")

Progress = Callable[[int, int], None]
"""Called with what is done, and what there is to do."""


class Steps:
    """Counts towards a total that a format says before it begins; what it counts are pictures, pings or rows.

    room: looked at while it counts, where what will not fit is to end at once
    """

    def __init__(self, progress: Progress = lambda done, total: None, room: Room | None = None) -> None:
        self._progress, self._room, self._done, self._total = progress, room, 0, 0

    def expect(self, count: int) -> None:
        """There are so many more to come."""
        self._total += count
        self._progress(self._done, self._total)

    def counted(self, items: Iterable[T]) -> Iterator[T]:
        """The items, each counted when it was dealt with."""
        for item in items:
            yield item
            self.done()

    def done(self) -> None:
        """One more was dealt with."""
        self._done += 1
        self._progress(self._done, max(self._done, self._total))
        if self._room is not None:
            self._room.check(self._done, self._total)

    def need(self, size: int) -> None:
        """So many bytes will be written. Raises MachineError where they do not fit."""
        if self._room is not None:
            self._room.need(size)


def frames(sequence: Sequence, cameras: Iterable[str], leaf: str = "image") -> int:
    """How many pictures of cameras, or layers of theirs, a sequence lists; 0 where it lists none."""
    counts = {topic: count for topic, _, count in sequence.contents()}
    return sum(counts.get(f"/{camera}/{leaf}", counts.get(camera, 0)) for camera in cameras)
