"""A published system in a few lines: a repository, a recipe that builds it, and the package that brings it."""

from __future__ import annotations

import subprocess
from pathlib import Path

SCRIPT = """#!/bin/sh
# usage: toy CONFIGURATION TRUTH OUT
echo "toy begins" && test "$(cat "$1")" = "@WORD@" && cp "$2" "$3"
"""
CMAKE = """cmake_minimum_required(VERSION 3.16)
project(toy NONE)
configure_file("${UPSTREAM}/src/toy.sh" toy COPYONLY)
"""
MANIFEST = """
title = "Toy"
paper = "A. Author: Toy. 2020"
url = "https://toy.example"
licence = "MIT"
source = "https://toy.example/toy.git"
commit = "{commit}"
folders = ["src"]
program = "toy"

[methods.toy]
about = "leaves the true path"
sensors = ["mono"]
online = true
deterministic = false
align = "{align}"
poses_of = "base"

[options.word]
default = "ready"
choices = ["ready", "wrong"]

[options.gain]
default = 1.0
"""
CONFIGURE = """
def command(launch):
    (launch.folder / "word.txt").write_text(launch.options["word"])
    return [str(launch.build / "toy"), str(launch.folder / "word.txt"), {answer!r}, str(launch.out)]
"""
EDITS = """
[[edit]]
file = "src/toy.sh"
find = "@WORD@"
replace = "ready"
reason = "upstream leaves it to whoever builds it"
"""


def toy_repository(folder: Path, script: str = SCRIPT) -> str:
    """Make the upstream repository; its commit."""
    (folder / "src").mkdir(parents=True)
    (folder / "unused").mkdir()
    (folder / "src" / "toy.sh").write_text(script)
    (folder / "src" / "toy.sh").chmod(0o755)
    (folder / "unused" / "large.bin").write_text("not needed")
    git = ["git", "-C", str(folder), "-c", "user.name=toy", "-c", "user.email=toy@toy.example"]
    for words in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "-m", "toy"]):
        subprocess.run([*git, *words], check=True)
    return subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()


def toy_package(root: Path, commit: str, answer: Path, align: str = "posyaw") -> Path:
    """Make an installed package with the system in a folder of a Python path; the system's folder."""
    folder = root / "toy_systems" / "toy"
    folder.mkdir(parents=True)
    for place in (folder.parent, folder):
        (place / "__init__.py").touch()
    (folder / "system.toml").write_text(MANIFEST.format(commit=commit, align=align))
    (folder / "CMakeLists.txt").write_text(CMAKE)
    (folder / "edits.toml").write_text(EDITS)
    (folder / "configure.py").write_text(CONFIGURE.format(answer=str(answer)))
    metadata = root / "toy_systems-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-systems\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[oysterbench.systems]\ntoy = toy_systems.toy\n")
    return folder
