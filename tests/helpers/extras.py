"""An environment in which only some extras are installed, made of this one, where all are."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.helpers.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]

BLOCKER = """
import sys
from importlib.machinery import PathFinder


class Installed(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in {blocked!r} else super().find_spec(name, path, target)


sys.meta_path = [Installed if finder is PathFinder else finder for finder in sys.meta_path]
"""


def only(extras: Iterable[str], folder: Path) -> dict[str, str]:
    """Variables of an environment in which what other extras bring cannot be imported. folder: for its start-up file"""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sitecustomize.py").write_text(BLOCKER.format(blocked=sorted(lacking(extras))))
    return {**os.environ, "PYTHONPATH": str(folder)}


def lacking(extras: Iterable[str]) -> set[str]:
    """Modules of the extras that are not among these."""
    names = set(EXTRAS) - {"all", "dev"}
    assert set(extras) <= names, f"expected extras, some of {sorted(names)}, got {sorted(extras)}"
    known = _distributions(PROJECT["dependencies"]) | {name for extra in extras for name in brought(extra)}
    others = {name for extra in names for name in brought(extra)} - known
    return {module for module, of in _installed().items() if {canonicalize_name(one) for one in of} <= others}


def brought(extra: str) -> set[str]:
    """Distributions that an extra asks for, and those of the extras that it is made of."""
    found = set()
    for requirement in map(Requirement, EXTRAS[extra]):
        if requirement.name == PROJECT["name"]:
            found |= {name for inner in requirement.extras for name in brought(inner)}
        else:
            found.add(canonicalize_name(requirement.name))
    return found


@cache
def _installed() -> Mapping[str, list[str]]:
    """Modules of all that is installed, with the distributions that hold them: it takes a second to read."""
    return packages_distributions()


def _distributions(requirements: Iterable[str]) -> set[str]:
    return {str(canonicalize_name(Requirement(text).name)) for text in requirements}
