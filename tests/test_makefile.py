"""What `make` runs exists."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from click import Context

from oysterbench.cli.main import main
from oysterbench.recipe import split_names
from tests.helpers.paths import ROOT

MAKEFILE = (ROOT / "Makefile").read_text()


def test_every_command_that_it_runs_is_one():
    commands = {*re.findall(r"/oysterbench ([a-z-]+)", MAKEFILE)}
    assert {"eval", "render", "publish", "publish-model", "models", "verify"} <= commands
    for name in commands:
        assert main.get_command(Context(main), name) is not None, name


def test_the_hub_of_a_release_is_of_the_minis_that_there_are():
    (listed,) = re.findall(r"for split in ([a-z -]+);", MAKEFILE)
    assert sorted(listed.split()) == sorted(name for name in split_names() if name.endswith("-mini"))


def test_a_hub_without_a_key_says_what_makes_one():
    line = next(line for line in MAKEFILE.splitlines() if 'test -f "$(KEY)"' in line)
    check = line.strip().lstrip("@").replace("$(KEY)", "nowhere.pem").replace("$(VENV)", ".venv")
    done = subprocess.run(["sh", "-c", check], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 2
    assert "'.venv/bin/oysterbench keygen FILE' makes one" in done.stdout


# Installing: `.ci/install.py`.
INSTALL = ROOT / ".ci" / "install.py"
LISTED = """:env:.default-timeout='180'
:env:.find-links='/srv/wheels /more/wheels'
global.extra-index-url='https://one.example/simple\\nhttps://two.example/simple'
global.find-links='/elsewhere'
global.index-url=https://mirror.example/simple
"""


def test_uv_looks_for_packages_where_pip_is_told_to():
    found = runpy.run_path(str(INSTALL))["uv_settings"](LISTED)
    assert found == {
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_FIND_LINKS": "/srv/wheels,/more/wheels",
        "UV_INDEX": "https://one.example/simple https://two.example/simple",
        "UV_DEFAULT_INDEX": "https://mirror.example/simple",
    }


def test_pip_writes_its_settings_as_they_are_read(tmp_path):
    """Of several lines in a file, of which `pip config list` prints one."""
    file = tmp_path / "pip.conf"
    file.write_text("[global]\nextra-index-url =\n    https://one.example/simple\n    https://two.example/simple\n")
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PIP_")}
    listed = subprocess.run(
        [sys.executable, "-m", "pip", "--disable-pip-version-check", "config", "list"],
        env=clean | {"PIP_CONFIG_FILE": str(file)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    found = runpy.run_path(str(INSTALL))["uv_settings"](listed)
    assert found["UV_INDEX"].split()[-2:] == ["https://one.example/simple", "https://two.example/simple"]


@pytest.mark.parametrize(
    ("fails", "ran", "status"),
    [
        ((), ["pip uv", "uv ."], 0),
        (("pip uv",), ["pip uv", "pip pip", "pip ."], 0),
        (("uv .",), ["pip uv", "uv .", "pip pip", "pip ."], 0),
        (("uv .", "pip ."), ["pip uv", "uv .", "pip pip", "pip ."], 1),
    ],
)
def test_what_uv_cannot_install_pip_does(monkeypatch, capsys, fails, ran, status):
    """By the programs that are run, and the last word of what they are to install."""
    seen: list[str] = []

    def run(command, env=None, **_):
        assert Path(command[0]) == Path(sys.executable)
        if "list" in command:
            return SimpleNamespace(returncode=0, stdout="")
        seen.append(f"{command[2]} {command[-1]}")
        assert command[command.index("--constraint") + 1] == ".ci/constraints.txt"
        assert (env is not None) == (command[2] == "uv")
        return SimpleNamespace(returncode=int(seen[-1] in fails))

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(sys, "argv", ["install.py", "."])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(INSTALL), run_name="__main__")
    assert ended.value.code == status
    assert seen == ran
    assert ("uv did not get through" in capsys.readouterr().err) == ("uv ." in fails)
