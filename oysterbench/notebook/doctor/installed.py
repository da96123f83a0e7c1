"""Checks of what is installed: this program, its dependencies and its extras, from the packages' metadata; none of them
is imported."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from typing import TYPE_CHECKING

from oysterbench.notebook.doctor.finding import Finding
from oysterbench.version import VERSION

if TYPE_CHECKING:
    from packaging.requirements import Requirement

EXTRAS = {
    "render": "renders splits",
    "slam": "runs the SLAM methods on GTSAM",
    "learn": "trains networks and runs them; data sets for PyTorch",
    "score": "scores single oysters, as COCO does",
    "serve": "serves a hub",
    "cluster": "renders and runs methods on a Dask cluster",
    "board": "adds results to a board, builds and serves its pages, takes submissions",
    "postgres": "keeps a board's submissions in PostgreSQL",
    "s3": "keeps a board's files in an object store",
    "rerun": "shows sequences in Rerun",
    "parquet": "writes data sets as Parquet, for Hugging Face",
    "maps": "writes maps of oysters as GeoTIFF, for GIS",
}
"""Extra -> its purpose. `all` is all of them; `dev` and `docs` are for developers of this program."""

OF_OTHERS = ("all", "dev", "docs")


def look_at_packages() -> Iterator[Finding]:
    """Check the program and its dependencies, then each extra."""
    about = f"Python {platform.python_version()}, {platform.system()} {platform.release()} {platform.machine()}"
    yield Finding("program", "oysterbench", "ok", f"{VERSION}, {about}, {sys.prefix}")
    needed = _requirements()
    absent, old, _ = _state(needed[""])
    wrong = [*absent, *old]
    advice = f"pip install -U {' '.join(map(_quoted, wrong))}"
    detail = f"{_versions(wrong)}; expected {', '.join(map(str, wrong))}" if wrong else f"{len(needed[''])} packages"
    yield Finding("program", "packages", "broken" if wrong else "ok", detail, advice if wrong else "")
    for extra in needed:
        if extra and extra not in OF_OTHERS:
            yield extra_finding(extra, needed[extra])


def extra_finding(extra: str, needed: Iterable[Requirement]) -> Finding:
    """Finding on an extra: complete, or with packages that are missing or of an unsuitable version."""
    purpose = EXTRAS.get(extra, "")
    absent, old, here = _state(needed)
    if old:
        detail = f"{purpose}: {_versions(old)}; expected {', '.join(map(str, old))}"
        return Finding("extras", extra, "broken", detail, f"pip install -U 'oysterbench[{extra}]'")
    if absent:
        lacking = ", ".join(sorted({one.name for one in absent}))
        return Finding(
            "extras", extra, "missing", f"{purpose}: without {lacking}", f"pip install 'oysterbench[{extra}]'"
        )
    return Finding("extras", extra, "ok", f"{purpose}: {_versions(here)}")


def _requirements() -> dict[str, list[Requirement]]:
    """Extra -> its requirements, from the metadata of the installation; those of every installation under an empty
    name."""
    from packaging.requirements import Requirement

    found: dict[str, list[Requirement]] = {"": []}
    for text in requires("oysterbench") or ():
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            found[""].append(requirement)
            continue
        for extra in (*EXTRAS, *OF_OTHERS):
            if requirement.marker.evaluate({"extra": extra}):
                found.setdefault(extra, []).append(requirement)
    for extra, needed in found.items():
        parts = {part for one in needed if one.name == "oysterbench" for part in one.extras}
        own = [one for one in needed if one.name != "oysterbench"]
        found[extra] = [*(one for part in sorted(parts) for one in found.get(part, ()) if part != extra), *own]
    return found


def _state(needed: Iterable[Requirement]) -> tuple[list[Requirement], list[Requirement], list[Requirement]]:
    """Sort requirements into those that are absent, those installed in an unsuitable version, and the others."""
    absent, old, here = [], [], []
    for one in needed:
        found = installed_version(one.name)
        if found is None:
            absent.append(one)
        elif not one.specifier.contains(found, prereleases=True):
            old.append(one)
        else:
            here.append(one)
    return absent, old, here


def installed_version(name: str) -> str | None:
    """Version of a package; None where it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _versions(needed: Iterable[Requirement]) -> str:
    return ", ".join(dict.fromkeys(f"{one.name} {installed_version(one.name) or 'absent'}" for one in needed))


def _quoted(requirement: Requirement) -> str:
    return f"'{requirement.name}{requirement.specifier}'"
