"""A published system, adapted as a method for the runner."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from oysterbench.core.errors import MethodError, OysterbenchError
from oysterbench.core.helpers import module_command
from oysterbench.methods.adapters import MethodAdapter, check_name
from oysterbench.methods.code import file_digest
from oysterbench.methods.interfaces import Predicted, RunSequence, interface_of
from oysterbench.methods.interfaces.slam import SequencePath
from oysterbench.methods.options import as_word, with_options
from oysterbench.methods.processes import STDOUT
from oysterbench.methods.systems.building import find_build
from oysterbench.methods.systems.launch import cameras_of, printed_command
from oysterbench.methods.systems.manifest import file_options, split_reference
from oysterbench.sequence import open_sequence
from oysterbench.version import VERSION


class SystemAdapter(MethodAdapter):
    """A method of a published system that has been built here."""

    def __init__(self, reference: str, tracks: Sequence[str] = ("slam",)) -> None:
        """Raises MethodError where there is no such method, it is of none of these tracks, or is not built."""
        found = split_reference(reference)
        if found is None:
            raise MethodError(f"no published system has a method {reference!r}; `oysterbench systems` lists them")
        self.system, self.name, self.options = found
        check_name(self.name.partition("[")[0])
        self.method = self.system.description.methods[self.name.partition("[")[0]]
        if self.method.track not in tracks:
            raise MethodError(
                f"method {reference!r} is of the track {self.method.track!r}; expected a method of {tracks[0]!r}"
            )
        self.build = find_build(self.system)
        self._files = file_options(self.system, self.options)
        # It is launched in another folder, with another home, so files are given by their absolute paths.
        self.reference = with_options(reference, [f"{key}={as_word(self.options[key])}" for key in self._files])
        self.interface = interface_of(self.method.track)
        self.form = self.method.form

    @property
    def identity(self) -> dict[str, Any]:
        return {
            "system": self.system.name,
            "build": self.build.recipe,
            "configuration": self._configuration,
            **self.settings,
            **({"files": self._digests} if self._files else {}),
        }

    @property
    def settings(self) -> dict[str, Any]:
        return {"method": self.name.partition("[")[0], **self.options, **self._digests}

    @property
    def about(self) -> Mapping[str, Any]:
        described = self.system.description
        found = {"title": described.title, "paper": described.paper, "code": described.source or described.url}
        if self.method.track != "slam":
            return found
        return {"sensors": list(self.method.sensors), "online": self.method.online, **found}

    @property
    def evaluation(self) -> Mapping[str, Any]:
        if self.method.track != "slam":
            return {}
        gap = {} if self.method.max_gap_s is None else {"max_gap_s": self.method.max_gap_s}
        return {"align": self.method.align, **gap}

    @property
    def limit_factor(self) -> float:
        return self.method.limit_factor

    @property
    def _digests(self) -> dict[str, str]:
        """SHA-256 of each file that the options name, as it is now."""
        return {key: file_digest(Path(self.options[key])) for key in self._files}

    @property
    def _configuration(self) -> str:
        """SHA-256 of the code that writes its configuration, and of the scripts that run it."""
        found = hashlib.sha256()
        for path in sorted([*self.system.folder.glob("*.py"), *(self.system.folder.parent / "common").glob("*.py")]):
            found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        return found.hexdigest()

    def versions(self) -> dict[str, str]:
        described = self.system.description
        known = {"oysterbench": VERSION, "compiler": self.build.compiler}
        if described.source:
            known |= {"source": described.source, "commit": described.commit}
        return {**known, **dict(one.split("==") for one in described.python if "==" in one)}

    def seed(self, number: int) -> int | None:
        return None if self.method.deterministic else number

    def preparation(self, given: Path, folder: Path, number: int) -> list[str]:
        # The path under the home is passed, as a method's environment does not say where the home is.
        asked = [self.reference, str(self.system.place), str(given), str(folder), str(number)]
        return module_command("oysterbench.methods.systems.launch", *asked)

    def command(self, given: Path, folder: Path, number: int) -> list[str]:
        return printed_command(folder / STDOUT)

    def check(self, sequence: RunSequence) -> None:
        """Check besides that the sequence has the sensors that the method uses: cameras, and inertial measurements."""
        super().check(sequence)
        if self.method.track == "slam" and isinstance(sequence, SequencePath):
            try:
                opened = open_sequence(sequence.path)
            except OysterbenchError:  # the run itself will report it
                return
            name = self.name.partition("[")[0]
            cameras_of(name, self.method, opened)
            if "imu" in self.method.sensors and not opened.has_imu:
                raise MethodError(
                    f"{name}: expected a sequence with inertial measurements, got {opened.name} without any; of a "
                    "split, --topics /imu adds them"
                )

    def take(self, sequence: RunSequence, given: Path, folder: Path) -> Predicted:
        if not (folder / self.interface.out).exists():
            raise MethodError(f"exited normally, but wrote no {self.interface.leaves.removeprefix('a ')}")
        options = {"poses_of": self.method.poses_of} if self.method.track == "slam" else {}
        found = self.interface.take(sequence, given, folder, self.form, options)
        digests = {"log_sha256": file_digest(folder / STDOUT)}
        written = sorted((folder / "configuration").glob("*"))
        kept = {path.name: file_digest(path) for path in written if path.is_file()}
        return replace(found, info={**found.info, **digests, "configuration_sha256": kept})
