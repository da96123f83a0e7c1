"""Every example in a docstring runs, and gives what it says."""

from __future__ import annotations

import doctest
import importlib
import shutil

import pytest

from tests.helpers.paths import ROOT

PACKAGES = {
    "oysterbench": "oysterbench",
    "baselines": "oysterbench_baselines",
    "leaderboard": "oysterbench_leaderboard",
}
"""Folder -> name of the package."""


def modules() -> list[str]:
    """Modules with examples, by their names."""
    found = []
    for folder, package in PACKAGES.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            if ">>> " in path.read_text(encoding="utf-8"):
                parts = path.relative_to(ROOT / folder).with_suffix("").parts
                found.append(".".join([package, *(part for part in parts if part != "__init__")]))
    return found


@pytest.mark.parametrize("module", modules())
def test_examples_in_docstrings_run(module, dive_file, tmp_path, monkeypatch):
    shutil.copy(dive_file, tmp_path / "mini-01.mcap")  # what examples open
    monkeypatch.chdir(tmp_path)
    done = doctest.testmod(importlib.import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert done.failed == 0
    assert done.attempted > 0
