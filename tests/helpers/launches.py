"""A run of a published system as its configure.py is given it, without a build."""

from __future__ import annotations

from pathlib import Path

from oysterbench.methods.systems.launch import Launch
from oysterbench.methods.systems.manifest import split_reference


def launch_of(reference: str, given: Path, folder: Path, number: int = 0) -> Launch:
    """Run `number` of a method on a sequence; source, build, configuration and trajectory lie in `folder`."""
    found = split_reference(reference)
    assert found is not None
    system, name, options = found
    method = name.partition("[")[0]
    return Launch(
        method=method,
        about=system.description.methods[method],
        options=options,
        given=given,
        source=folder / "source",
        build=folder / "build",
        folder=folder,
        out=folder / "trajectory.tum",
        number=number,
    )
