"""Jobs and their outcomes: each job has a folder, with outcome.json once it is finished."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MethodError
from oysterbench.methods.adapters import MethodAdapter
from oysterbench.methods.interfaces import RunSequence

OUTCOME = "outcome.json"
FORMAT = "oysterbench-outcome/2"
OF_SPLIT = ("split", "recipe", "sequence")
"""What the origin of a split's sequence begins with; topics may follow."""


@dataclass(frozen=True)
class Job:
    """Run `number`, from 0, out of `of` runs of a method on a sequence."""

    adapter: MethodAdapter
    sequence: RunSequence
    number: int
    limit_s: float
    of: int = 1

    @property
    def title(self) -> str:
        """The job's name in messages."""
        return f"{self.adapter.name} on {self.sequence.name}, run {self.number + 1}"

    def folder(self, root: Path) -> Path:
        """Folder where the job's predictions and logs are kept."""
        return root / "runs" / self.adapter.name / self.sequence.name / f"{self.number + 1}"

    @property
    def identity(self) -> dict[str, Any]:
        """What the identity of an outcome must equal for it to be this job's."""
        seed = self.adapter.seed(self.number)
        return {"method": self.adapter.identity, "origin": self.sequence.origin, "seed": seed, "run": self.number}


@dataclass(frozen=True)
class Outcome:
    """Outcome of a job.

    failure:      why there are no predictions; None if there are
    wall_s/cpu_s: cost of the method: of its own `run` if it is in Python, otherwise of the whole process
    process:      of the whole process: wall_s, cpu_s, peak_bytes, and left_behind, processes that had to be killed
    command:      as it was run; started, ended: UTC, ISO 8601
    contained:    whether the kernel hid the ground truth, rather than it only being left out of the method's input
    info, notes:  from the method, and from reading its predictions
    prediction:   what the method's interface needs to read the predictions
    earlier:      whether it was read from the folder of an earlier run
    finished:     False if the machine failed rather than the method: the outcome is not kept, so the job is run again
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
    earlier: bool = False

    def write(self, folder: Path) -> None:
        """Write outcome.json atomically."""
        write_atomically(folder / OUTCOME, json.dumps({"format": FORMAT, **asdict(self)}, indent=1).encode())


def differing(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Names of what differs in two identities of jobs, apart from the files that methods and sequences consist of."""
    old, new = ({**one["method"], "seed": one["seed"]} for one in (before, now))
    keys = [key for key in {**new, **old} if key != "files" and old.get(key) != new.get(key)]
    origins = [one["origin"].partition("\n")[0] for one in (before, now)]
    if origins[0] == origins[1]:
        return keys
    first, second = (origin.split(" ") for origin in origins)
    own = any(origin.startswith("/") for origin in origins)
    if own or min(len(first), len(second)) < len(OF_SPLIT):  # a file or folder, or the digest of labels
        return [*keys, "sequence"]
    named = [name for name, one, other in zip(OF_SPLIT, first, second, strict=False) if one != other]
    topics = first[len(OF_SPLIT) :] != second[len(OF_SPLIT) :]
    return [*keys, *named, *(["topics"] if topics else [])]


def read_outcome(folder: Path) -> Outcome | None:
    """Read the outcome in a folder; None if there is none yet. Raises MethodError where it has another format."""
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
