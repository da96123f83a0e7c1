"""What is installed is what there is: every package is named in pyproject.toml, and every file that one reads."""

from __future__ import annotations

import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

from tests.helpers.paths import ROOT

SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
READ_IN_THE_CHECKOUT_ONLY = ("datasets/pictures/*",)


def packages() -> dict[str, Path]:
    """Name -> folder of every package of the tree."""
    found = {}
    for name, folder in SETUPTOOLS["package-dir"].items():
        for path in (ROOT / folder).rglob("__init__.py"):
            found[".".join([name, *path.parent.relative_to(ROOT / folder).parts])] = path.parent
    return found


def test_every_package_is_installed():
    assert sorted(SETUPTOOLS["packages"]) == sorted(packages())


@pytest.mark.parametrize("name", sorted(packages()))
def test_every_file_of_a_package_is_installed(name):
    known = packages()
    patterns = [*SETUPTOOLS["package-data"].get(name, []), *SETUPTOOLS["package-data"]["*"], "*.py"]
    for path in known[name].rglob("*"):
        nearest = next(folder for folder in path.parents if folder in known.values())
        if not path.is_file() or nearest != known[name] or "__pycache__" in path.parts:
            continue
        if any(path.relative_to(ROOT).match(pattern) for pattern in READ_IN_THE_CHECKOUT_ONLY):
            continue
        where = str(path.relative_to(known[name]))
        assert any(fnmatch(where, pattern) for pattern in patterns), f"{path} is not in the package-data of {name}"
