"""Helper processes: they import what this process imports."""

from __future__ import annotations

import subprocess
import sys

import pytest

from oysterbench.core.helpers import module_command


@pytest.mark.parametrize(
    ("first", "imported"),
    [("installed", "installed"), ("here", "here"), ("", "here"), (None, "installed")],
    ids=["a command", "python -m", "a notebook", "nothing"],
)
def test_modules_of_the_working_folder_come_first_only_where_they_do_in_this_process(
    first, imported, tmp_path, monkeypatch
):
    for place in ("installed", "here"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "my_helper.py").write_text(f"import sys\nprint({place!r}, *sys.argv[1:])\n")
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "installed"))
    elsewhere = [path for path in sys.path if path]
    own = [] if first is None else [str(tmp_path / first) if first else ""]
    monkeypatch.setattr("sys.path", [*own, *elsewhere, str(tmp_path / "here")])
    done = subprocess.run(module_command("my_helper", "a", tmp_path), capture_output=True, text=True, check=False)
    assert done.stdout == f"{imported} a {tmp_path}\n", done.stderr
