"""What `make` runs exists."""

from __future__ import annotations

import re
import subprocess

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
