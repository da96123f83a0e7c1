"""A published system as a method that the runner runs."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from oysterbench.core.errors import MethodError
from oysterbench.methods.adapters import MethodAdapter, check_name
from oysterbench.methods.interfaces import Predicted, RunSequence, interface_of
from oysterbench.methods.processes import STDOUT
from oysterbench.methods.systems.building import built
from oysterbench.methods.systems.manifest import split_reference
from oysterbench.version import VERSION


class SystemAdapter(MethodAdapter):
    """A method of a published system that is built here."""

    def __init__(self, reference: str, tracks: Sequence[str] = ("slam",)) -> None:
        """Raises MethodError where there is no such method, it is of none of these tracks, or it is not built."""
        found = split_reference(reference)
        if found is None:
            raise MethodError(f"no published system has a method {reference!r}; `oysterbench systems` lists them")
        self.system, self.name, self.options = found
        check_name(self.name.partition("[")[0])
        if "slam" not in tracks:
            raise MethodError(f"method {reference!r} is of the track 'slam'; expected one of {tracks[0]!r}")
        build = built(self.system)
        if build is None:
            raise MethodError(
                f"{self.system.name} is not built here; type: oysterbench systems build {self.system.name}"
            )
        self.build = build
        self.reference = reference
        self.method = self.system.description.methods[self.name.partition("[")[0]]
        self.interface = interface_of("slam")
        self.form = self.method.form

    @property
    def identity(self) -> dict[str, Any]:
        return {
            "system": self.system.name,
            "build": self.build.recipe,
            "configuration": self._configuration,
            **self.settings,
        }

    @property
    def settings(self) -> dict[str, Any]:
        return {"method": self.name.partition("[")[0], **self.options}

    @property
    def about(self) -> Mapping[str, Any]:
        described = self.system.description
        known = {"sensors": list(self.method.sensors), "online": self.method.online}
        return {**known, "title": described.title, "paper": described.paper, "code": described.source or described.url}

    @property
    def evaluation(self) -> Mapping[str, Any]:
        gap = {} if self.method.max_gap_s is None else {"max_gap_s": self.method.max_gap_s}
        return {"align": self.method.align, **gap}

    @property
    def _configuration(self) -> str:
        """SHA-256 of what writes its configuration, and of scripts that run it."""
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

    def command(self, given: Path, folder: Path, number: int) -> list[str]:
        # The home is named, as the environment of a method does not say where it is.
        asked = [self.reference, str(self.system.place), str(given), str(folder), str(number)]
        return [sys.executable, "-m", "oysterbench.methods.systems.launch", *asked]

    def take(self, sequence: RunSequence, given: Path, folder: Path) -> Predicted:
        if not (folder / self.interface.out).exists():
            raise MethodError("ended well, but left no trajectory")
        options = {"poses_of": self.method.poses_of}
        found = self.interface.take(sequence, given, folder, self.form, options)
        digests = {"log_sha256": _digest(folder / STDOUT)}
        kept = {path.name: _digest(path) for path in sorted((folder / "configuration").glob("*")) if path.is_file()}
        return replace(found, info={**found.info, **digests, "configuration_sha256": kept})


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
