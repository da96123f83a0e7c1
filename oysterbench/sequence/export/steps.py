"""Progress of an export: a format announces what it will write, and counts it while writing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from oysterbench.core.disk_space import SpaceCheck
from oysterbench.sequence.types import Sequence

T = TypeVar("T")

Progress = Callable[[int, int], None]
"""Called with the number of steps done and the total."""


class Steps:
    """Counter towards a total that a format announces before it starts; it counts images, pings or rows.

    space: checked while counting, so that an export that will not fit ends early
    """

    def __init__(self, progress: Progress = lambda done, total: None, space: SpaceCheck | None = None) -> None:
        self._progress, self._space, self._done, self._total = progress, space, 0, 0

    def expect(self, count: int) -> None:
        """Announce `count` more steps."""
        self._total += count
        self._progress(self._done, self._total)

    def counted(self, items: Iterable[T]) -> Iterator[T]:
        """Yield the items, counting each once it has been processed."""
        for item in items:
            yield item
            self.done()

    def done(self) -> None:
        """Count one more step. Raises MachineError where the rest will not fit on the disk."""
        self._done += 1
        self._progress(self._done, max(self._done, self._total))
        if self._space is not None:
            self._space.check(self._done, self._total)

    def need(self, size: int) -> None:
        """Announce that `size` bytes will be written. Raises MachineError where they do not fit."""
        if self._space is not None:
            self._space.need(size)


def frames(sequence: Sequence, cameras: Iterable[str], leaf: str = "image") -> int:
    """Number of images of cameras, or of their layer `leaf`, that a sequence lists; 0 where it lists none."""
    counts = {topic: count for topic, _, count in sequence.contents()}
    return sum(counts.get(f"/{camera}/{leaf}", counts.get(camera, 0)) for camera in cameras)
