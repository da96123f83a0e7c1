"""How data is exchanged with the methods of a track across a process boundary: files in, files out, no ground truth."""

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
    """What a run left besides its prediction files.

    info: what the method reports about itself (JSON values); prediction: what its interface needs to read those files;
    wall_s, cpu_s: wall and CPU time as the method's process measured them, None if it did not; notes: remarks from
    reading the predictions
    """

    info: Mapping[str, Any] = field(default_factory=dict)
    prediction: Mapping[str, Any] = field(default_factory=dict)
    wall_s: float | None = None
    cpu_s: float | None = None
    notes: Sequence[str] = ()


class RunSequence(ABC):
    """A sequence that methods are run on.

    name: used in tables and for folders; origin: what the sequence was made from: results with another origin are not
    results on this sequence; hidden: files and folders with its ground truth, which no method may open; limit_s:
    default time limit of a run; split: the split that it belongs to, None for a sequence of the user's own; source: the
    user's file or folder, if the input of Python methods has the same files under the same names
    """

    name: str
    split: SplitRecipe | None = None

    @property
    @abstractmethod
    def origin(self) -> str:
        """What the sequence was made from."""

    @property
    @abstractmethod
    def hidden(self) -> tuple[Path, ...]:
        """Files and folders with its ground truth."""

    @property
    @abstractmethod
    def limit_s(self) -> float:
        """Default time limit of a run, s."""

    @property
    def source(self) -> Path | None:
        """The user's file or folder."""
        return None

    @abstractmethod
    def write_input(self, form: str, out: Path, processes: Processes) -> None:
        """Write the input that a method receives, in a form and without the ground truth. Raises MethodError."""


class Interface(ABC):
    """How methods of a kind receive their input and leave their predictions.

    forms:    input forms of programs: placeholder of the command line -> description of what replaces it
    own_form: input form of Python methods
    lasting:  forms that take long to write and are therefore kept for other runs
    out:      file or folder name of what a program leaves at {out}; leaves: the same in words
    further:  placeholder -> file name of a further, optional output
    """

    forms: ClassVar[Mapping[str, str]]
    own_form: ClassVar[str]
    lasting: ClassVar[tuple[str, ...]]
    out: ClassVar[str]
    leaves: ClassVar[str]
    further: ClassVar[Mapping[str, str]] = {}

    def input_name(self, sequence: RunSequence, form: str) -> str:
        """Return the name of the file or folder of an input."""
        return sequence.name

    def options_of(self, form: str, poses_of: str = "") -> dict[str, str]:
        """Options that, beside the form, decide how a program's output is read. Raises MethodError for others."""
        if poses_of:
            raise MethodError(f"--poses-of is for the track slam; here a program writes {self.leaves}")
        return {}

    def check(self, sequence: RunSequence, form: str, options: Mapping[str, str]) -> None:
        """Check, before a run, that its output can be read with these options. Raises MethodError if not."""
        return

    @abstractmethod
    def predict(self, method: Any, given: Path, folder: Path, watch: Stopwatch) -> Predicted:
        """Run a Python method on its input and write its predictions into a folder; called in the method's process."""

    @abstractmethod
    def take(
        self, sequence: RunSequence, given: Path, folder: Path, form: str, options: Mapping[str, str]
    ) -> Predicted:
        """Check what a program left in a folder and write it as `predict` does. Raises MethodError with one line."""


class Stopwatch:
    """Context manager that adds up the wall and CPU time of its blocks, threads and child processes included."""

    def __init__(self) -> None:
        self.wall_s = self.cpu_s = 0.0

    def leave_out(self, items: Iterable[T]) -> Iterator[T]:
        """Pass on a method's inputs without counting the time that it takes to produce them."""
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
