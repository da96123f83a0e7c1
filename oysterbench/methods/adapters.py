"""Who is run: a method of Python, or another program by its command line. Both become a command and an answer."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import shutil
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from string import Formatter
from typing import Any

from oysterbench.core.errors import MethodError, TrajectoryError
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.methods.finding import find_variant, versions_of
from oysterbench.methods.inputs import FORMS, POSES_OF, SENSORS, frame_pose, kitti_stamps
from oysterbench.methods.method import seed_of
from oysterbench.methods.worker import ANSWER, ESTIMATE
from oysterbench.sequence import open_sequence
from oysterbench.version import VERSION

PLAIN_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*")
PACKAGES = ("numpy", "scipy", "opencv-python-headless", "gtsam", "torch")
"""Packages whose versions are kept with a result, where they are installed."""


SAID = ("info", "wall_s", "cpu_s", "scored", "alternatives", "map")
"""Keys of what a method of Python says in answer.json."""


@dataclass(frozen=True)
class Answer:
    """What a run left: poses T_odom_base, what it says of itself, and its own account of what it cost, if any.

    scored, alternatives: names of the path that is scored and of further ones, which lie beside it; map: counts of its
    key frames and landmarks, None where there is no map.
    """

    trajectory: Trajectory
    info: Mapping[str, Any] = field(default_factory=dict)
    wall_s: float | None = None
    cpu_s: float | None = None
    scored: str = ""
    alternatives: Sequence[str] = ()
    map: Mapping[str, int] | None = None


class Entrant(ABC):
    """Who is run. name: in tables and as a folder; form: what it is given (`inputs.FORMS` and `inputs.SENSORS`)."""

    name: str
    form: str

    @property
    @abstractmethod
    def identity(self) -> dict[str, Any]:
        """What tells it from another entrant of the same name, as JSON values."""

    @property
    def settings(self) -> dict[str, Any]:
        """Goes into the record as the settings of the method."""
        return {}

    @abstractmethod
    def versions(self) -> dict[str, str]:
        """Of what is run, by name."""

    @abstractmethod
    def seed(self, number: int) -> int | None:
        """Of run `number`, from 0; None for who takes none."""

    @abstractmethod
    def command(self, given: Path, folder: Path, number: int) -> list[str]:
        """The command of run `number`. given: the sequence in its form; folder: where the answer goes."""

    @abstractmethod
    def answer(self, sequence: Path, given: Path, folder: Path) -> Answer:
        """What it left in its folder. Raises MethodError, in one line, where that is not an estimate."""

    def said_failure(self, folder: Path) -> str | None:
        """Its own word on why it failed, where it has one."""
        return None


class PythonMethod(Entrant):
    """A method by the name of an entry point or as `module:Class`, with or without options, run by `worker`.

    The worker opens a sequence from which the truth was cut: no attribute, however private, leads to it.
    """

    form = SENSORS

    def __init__(self, reference: str, track: str = "slam") -> None:
        """Raises MethodError where it cannot be found, or is of another track."""
        method, self._options = find_variant(reference)
        if method.track != track:
            raise MethodError(f"method {reference!r} is of the track {method.track!r}; expected one of {track!r}")
        self.reference = reference
        check_name(method.name.partition("[")[0])
        self.name = method.name
        self._first_seed = seed_of(method)

    @property
    def identity(self) -> dict[str, Any]:
        return {"method": self.reference, "versions": versions_of(self.reference)}

    @property
    def settings(self) -> dict[str, Any]:
        return dict(self._options)

    def versions(self) -> dict[str, str]:
        found = {"python": sys.version.split()[0], "oysterbench": VERSION, **versions_of(self.reference)}
        for package in PACKAGES:
            try:
                found[package] = version(package)
            except PackageNotFoundError:
                continue
        return found

    def seed(self, number: int) -> int | None:
        return None if self._first_seed is None else self._first_seed + number

    def command(self, given: Path, folder: Path, number: int) -> list[str]:
        seed = self.seed(number)
        asked = [self.reference, str(given), str(folder), *([] if seed is None else [str(seed)])]
        return [sys.executable, "-m", "oysterbench.methods.worker", *asked]

    def answer(self, sequence: Path, given: Path, folder: Path) -> Answer:
        said = json.loads((folder / ANSWER).read_text(encoding="utf-8"))
        trajectory = read_as_given(folder / ESTIMATE)
        return Answer(trajectory, **{key: said[key] for key in SAID})

    def said_failure(self, folder: Path) -> str | None:
        try:
            return json.loads((folder / ANSWER).read_text(encoding="utf-8")).get("failure")
        except (OSError, ValueError):
            return None


class Command(Entrant):
    """Another program. Its command line has {out}, where it leaves a trajectory, and one of the names of `FORMS`.

    poses_of: whose poses it answers with: base, imu, camera or a camera's name; that of the form by default.
    """

    def __init__(self, template: str, name: str = "", poses_of: str = "") -> None:
        """Raises MethodError where the command line is not of that shape, or its program is not there."""
        self.template = template
        try:
            self._words = shlex.split(template)
            asked = {key for word in self._words for _, key, _, _ in Formatter().parse(word) if key is not None}
        except ValueError as error:
            raise MethodError(f"--command {template!r}: {error}; write {{{{ and }}}} for braces of your own") from None
        known = [*FORMS, "out", "seed"]
        for key in sorted(asked - set(known)):
            raise MethodError(
                f"--command {template!r}: unknown placeholder {{{key}}}; known: "
                f"{', '.join(f'{{{k}}}' for k in known)}; write {{{{ and }}}} for braces of your own"
            )
        forms = sorted(asked & set(FORMS))
        if "out" not in asked or len(forms) != 1:
            raise MethodError(
                f"--command {template!r}: expected {{out}}, where the program leaves its trajectory, and one of "
                f"{', '.join(f'{{{form}}}' for form in FORMS)}, what it reads, got "
                f"{', '.join(f'{{{key}}}' for key in sorted(asked)) or 'no placeholder'}"
            )
        program = shutil.which(self._words[0])
        if program is None:
            raise MethodError(f"--command {template!r}: no program {self._words[0]!r} that can be run")
        self.program = Path(program).absolute()  # not resolved: the name may decide what it does
        self.name = check_name(name or Path(self._words[0]).stem)
        self.form = forms[0]
        self.poses_of = poses_of or POSES_OF[self.form]
        self._takes_seed = "seed" in asked

    @property
    def identity(self) -> dict[str, Any]:
        return {"command": self.template, "poses_of": self.poses_of}

    @property
    def settings(self) -> dict[str, Any]:
        return self.identity

    @cached_property
    def _program_sha256(self) -> str:
        with open(self.program, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def versions(self) -> dict[str, str]:
        return {"oysterbench": VERSION, "program": str(self.program), "program_sha256": self._program_sha256}

    def seed(self, number: int) -> int | None:
        return number if self._takes_seed else None

    def command(self, given: Path, folder: Path, number: int) -> list[str]:
        values: dict[str, str] = {self.form: str(given), "out": str(self.out(folder)), "seed": str(number)}
        return [str(self.program), *(word.format(**values) for word in self._words[1:])]

    def out(self, folder: Path) -> Path:
        """What is put in the place of {out}."""
        return folder / "trajectory.tum"

    def answer(self, sequence: Path, given: Path, folder: Path) -> Answer:
        out = self.out(folder)
        if not out.exists():
            raise MethodError("ended well, but left no trajectory at {out}")
        opened = open_sequence(sequence)
        T_base_frame = frame_pose(opened, self.poses_of, self.form)
        if self.form != "kitti":
            return Answer(read_as_given(out, T_body_estimate=T_base_frame))
        stamps = kitti_stamps(opened, given)
        found = read_as_given(out, T_body_estimate=T_base_frame, times=stamps)
        if len(found) and found.stamps_ns[-1] < stamps[0]:
            note = "its stamps count from the first image, as times.txt has them: the stamp of that was added"
            found = replace(found, stamps_ns=found.stamps_ns + stamps[0], notes=(*found.notes, note))
        return Answer(found)


def read_as_given(path: Path, **options: Any) -> Trajectory:
    """The trajectory that a run left. Raises MethodError where it cannot be read."""
    try:
        return read_trajectory(path, **options)
    except TrajectoryError as error:
        raise MethodError(f"left what cannot be read as a trajectory: {error}") from None


def check_name(name: str) -> str:
    """A name that can be a folder's. Raises MethodError for others."""
    if not PLAIN_NAME.fullmatch(name):
        raise MethodError(f"name of a method: expected letters, digits and . _ + -, got {name!r}")
    return name
