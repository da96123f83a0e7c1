"""Jobs, and what became of them: a folder for each, with outcome.json once it is finished."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from oysterbench.core.errors import MethodError
from oysterbench.core.files import write_atomically
from oysterbench.methods.adapters import MethodAdapter
from oysterbench.methods.interfaces import RunSequence

OUTCOME = "outcome.json"
FORMAT = "oysterbench-outcome/2"


@dataclass(frozen=True)
class Job:
    """Run `number`, from 0, of so many, of a method on a sequence."""

    adapter: MethodAdapter
    sequence: RunSequence
    number: int
    limit_s: float
    of: int = 1

    @property
    def title(self) -> str:
        """What it is in messages."""
        return f"{self.adapter.name} on {self.sequence.name}, run {self.number + 1}"

    def folder(self, root: Path) -> Path:
        """Where its predictions and its logs are kept."""
        return root / "runs" / self.adapter.name / self.sequence.name / f"{self.number + 1}"

    @property
    def identity(self) -> dict[str, Any]:
        """What an outcome must have been made by to be taken for this job's."""
        seed = self.adapter.seed(self.number)
        return {"method": self.adapter.identity, "origin": self.sequence.origin, "seed": seed, "run": self.number}


@dataclass(frozen=True)
class Outcome:
    """What became of a job.

    failure:      why there are no predictions; None where there are
    wall_s/cpu_s: of the method: of its own `run` where it is Python, of the whole process otherwise
    process:      of the whole process: wall_s, cpu_s, peak_bytes, and left_behind, processes that had to be ended
    command:      as it was run; versions, hardware, started, ended: UTC, ISO 8601
    contained:    whether the truth was hidden by the kernel, and not only left out of what the method was given
    info, notes:  of the method, and of the reading of its predictions
    prediction:   what the interface of the method has to know to read them
    finished:     False where the machine failed, and not the method: then nothing is kept, so that it is run again
    """

    identity: Mapping[str, Any]
    failure: str | None
    wall_s: float
    cpu_s: float
    process: Mapping[str, float]
    command: list[str]
    limit_s: float
    versions: Mapping[str, str]
    hardware: Mapping[str, Any]
    started: str
    ended: str
    info: Mapping[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    prediction: Mapping[str, Any] = field(default_factory=dict)
    contained: bool = False
    finished: bool = True

    def write(self, folder: Path) -> None:
        """Whole or not at all."""
        write_atomically(folder / OUTCOME, json.dumps({"format": FORMAT, **asdict(self)}, indent=1).encode())


def read_outcome(folder: Path) -> Outcome | None:
    """The outcome in a folder, None where there is none yet."""
    path = folder / OUTCOME
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        if values.pop("format") != FORMAT:
            raise ValueError(f"expected {FORMAT}")
        return Outcome(**values)
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise MethodError(
            f"{path}: not in this version's format ({error}); rerun it with --again, or choose another folder with "
            "--out"
        ) from None
