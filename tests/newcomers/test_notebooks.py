"""The notebooks run from the first cell to the last, on the minis, and are made of the public library alone."""

from __future__ import annotations

import ast
import json
import subprocess
import sys

import pytest

import oysterbench
from tests.helpers.paths import ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LIMIT_S = 600


def cells(path, kind):
    """The texts of its cells of a kind."""
    return ["".join(cell["source"]) for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == kind]


def test_there_are_five():
    assert [path.stem[0] for path in NOTEBOOKS] == ["1", "2", "3", "4", "5"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_outputs(path):
    for cell in json.loads(path.read_text())["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_begins_by_saying_what_it_is_and_what_to_install(path):
    assert cells(path, "markdown")[0].startswith("# ")
    assert 'pip install "oysterbench[' in cells(path, "markdown")[0]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_needs_the_public_library_alone(path):
    for text in cells(path, "code"):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom):
                assert not (node.module or "").startswith("oysterbench"), text
            if isinstance(node, ast.Import):
                assert all(name.name == "oysterbench" or "oysterbench" not in name.name for name in node.names), text
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "oysterbench":
                assert node.attr in oysterbench.__all__


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, minis, tmp_path, monkeypatch):
    pytest.importorskip("nbclient", reason="nbclient is not installed: pip install 'oysterbench[dev]'")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install 'oysterbench[dev]'")
    if "torch" in "".join(cells(path, "code")):
        pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")
    monkeypatch.setenv("OYSTERBENCH_HOME", str(minis))
    words = [sys.executable, "-m", "tests.helpers.run_notebook", str(path), str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert "the same bytes: False" not in done.stdout
