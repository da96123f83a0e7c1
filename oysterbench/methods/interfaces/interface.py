"""How the methods of a track are spoken to across the border of a process: files in, files out, and no truth."""

from __future__ import annotations

import resource
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from oysterbench.core.errors import MethodError
from oysterbench.methods.processes import Processes

if TYPE_CHECKING:
    from oysterbench.recipe import SplitRecipe

T = TypeVar("T")


@dataclass(frozen=True)
class Predicted:
    """What a run left, beside the files of its predictions.

    info: what the method says of itself (JSON values); prediction: what its interface has to know to read them;
    wall_s, cpu_s: its own account of what it cost, None where it has none; notes: of the reading
    """

    info: Mapping[str, Any] = field(default_factory=dict)
    prediction: Mapping[str, Any] = field(default_factory=dict)
    wall_s: float | None = None
    cpu_s: float | None = None
    notes: Sequence[str] = ()


class RunSequence(ABC):
    """A sequence that methods are run on.

    name: in tables and of folders; origin: what made it, as results of another origin are not results on this one;
    hidden: files and folders with its truth, which no method may open; limit_s: what a run may take by default
    split: that it is of, None for one of the user's own
    """

    name: str
    split: SplitRecipe | None = None

    @property
    @abstractmethod
    def origin(self) -> str:
        """What made it."""

    @property
    @abstractmethod
    def hidden(self) -> tuple[Path, ...]:
        """Where its truth is."""

    @property
    @abstractmethod
    def limit_s(self) -> float:
        """Time limit of a run, s."""

    @abstractmethod
    def write_input(self, form: str, out: Path, processes: Processes) -> None:
        """Write what a method is given of it, in a form and without the truth. Raises MethodError."""


class Interface(ABC):
    """How methods of a kind are given their input and leave their predictions.

    forms:    placeholder of a command line -> what is put in its place
    own_form: what a method of Python is given
    lasting:  those of both that take long to write, and are kept for other runs
    out:      name of what a program leaves at {out}; leaves: the same in words
    further:  placeholder -> name of what a program may leave as well
    """

    forms: ClassVar[Mapping[str, str]]
    own_form: ClassVar[str]
    lasting: ClassVar[tuple[str, ...]]
    out: ClassVar[str]
    leaves: ClassVar[str]
    further: ClassVar[Mapping[str, str]] = {}

    def input_name(self, sequence: RunSequence, form: str) -> str:
        """Name of the file or folder of an input."""
        return sequence.name

    def options_of(self, form: str, poses_of: str = "") -> dict[str, str]:
        """What decides beside the form how a program's predictions are read. Raises MethodError for what does not."""
        if poses_of:
            raise MethodError(f"--poses-of is for the track slam; here a program writes {self.leaves}")
        return {}

    def check(self, sequence: RunSequence, form: str, options: Mapping[str, str]) -> None:
        """Raises MethodError where what a program will leave could not be read as the options say, before it runs."""
        return

    @abstractmethod
    def predict(self, method: Any, given: Path, folder: Path, watch: Stopwatch) -> Predicted:
        """In the process of the method: run it on its input, and write its predictions into a folder."""

    @abstractmethod
    def take(
        self, sequence: RunSequence, given: Path, folder: Path, form: str, options: Mapping[str, str]
    ) -> Predicted:
        """Check what a program left in a folder, and write it as `predict` does. Raises MethodError in one line."""


class Stopwatch:
    """Wall and processor time of a method, of its threads and children too: what runs between `with` and its end."""

    def __init__(self) -> None:
        self.wall_s = self.cpu_s = 0.0

    def leave_out(self, items: Iterable[T]) -> Iterator[T]:
        """What a method is given; what its reading takes is not the method's."""
        before = self._now()
        for item in items:
            self._add(before, -1)
            yield item
            before = self._now()
        self._add(before, -1)

    def _now(self) -> tuple[float, float]:
        both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        return time.perf_counter(), sum(usage.ru_utime + usage.ru_stime for usage in both)

    def _add(self, before: tuple[float, float], sign: int) -> None:
        now = self._now()
        self.wall_s += sign * (now[0] - before[0])
        self.cpu_s += sign * (now[1] - before[1])

    def __enter__(self) -> None:
        self._began = self._now()

    def __exit__(self, *_: object) -> None:
        self._add(self._began, 1)
