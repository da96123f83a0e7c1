"""Jobs, and what became of them: a folder for each, with outcome.json once it is finished."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from oysterbench.core.errors import MethodError
from oysterbench.core.files import write_atomically
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.methods.entrants import Entrant
from oysterbench.methods.worker import ESTIMATE, alternative_file

OUTCOME = "outcome.json"
FORMAT = "oysterbench-outcome/1"


@dataclass(frozen=True)
class Job:
    """Run `number`, from 0, of an entrant on the sequence `name` at `path`; `origin` says what made the sequence."""

    entrant: Entrant
    name: str
    path: Path
    number: int
    limit_s: float
    origin: str = ""

    def folder(self, root: Path) -> Path:
        """Where its answer and its logs are kept."""
        return root / "runs" / self.entrant.name / self.name / f"{self.number + 1}"

    @property
    def identity(self) -> dict[str, Any]:
        """What an outcome must have been made by to be taken for this job's."""
        seed = self.entrant.seed(self.number)
        return {"entrant": self.entrant.identity, "origin": self.origin, "seed": seed, "run": self.number}


@dataclass(frozen=True)
class Outcome:
    """What became of a job.

    failure:      why there is no estimate; None where there is one
    wall_s/cpu_s: of the method: of its own `run` where it is Python, of the whole process otherwise
    process:      of the whole process: wall_s, cpu_s, peak_bytes, and left_behind, processes that had to be ended
    command:      as it was run; versions, hardware, started, ended: UTC, ISO 8601
    info, notes:  of the method, and of the reading of its answer
    scored:       what the method calls the path that is scored; alternatives: names of the others
    map:          counts of the map's key frames and landmarks, None where there is none
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
    scored: str = ""
    alternatives: list[str] = field(default_factory=list)
    map: Mapping[str, int] | None = None

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
            f"{path}: not what this version writes ({error}); --again runs it anew, --out chooses another folder"
        ) from None


def estimate_of(folder: Path) -> Trajectory:
    """Poses T_odom_base of a job that did not fail."""
    return read_trajectory(folder / ESTIMATE)


def alternatives_of(folder: Path, outcome: Outcome) -> dict[str, Trajectory]:
    """Its further paths by name."""
    return {name: read_trajectory(folder / alternative_file(name)) for name in outcome.alternatives}
