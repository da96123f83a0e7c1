"""A published system in a few lines: a repository, a recipe that builds it, and the package that brings it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from oysterbench.methods.systems import systems

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
limit_factor = 1.5

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

IMAGE_MANIFEST = """
title = "Toy"
paper = "A. Author: Toy. 2020"
url = "https://toy.example"
licence = "MIT"
program = "segment.py"

[methods.toy_masks]
about = "what is light, in one mask"
track = "segmentation"
form = "images"
deterministic = true

[methods.toy_oysters]
about = "what is light, piece by piece"
track = "detection"
form = "images"
deterministic = true

[options.weights]
file = true
default = "models/toy.txt"
made_by = "echo 120 > toy.txt"

[options.channel]
default = 0
choices = [0, 1]
"""
IMAGE_CONFIGURE = """
import sys
from pathlib import Path

def command(launch):
    (launch.folder / "channel.txt").write_text(str(launch.options["channel"]))
    words = [Path(__file__).with_name("segment.py"), launch.method, launch.options["weights"]]
    return [sys.executable, *map(str, [*words, launch.folder / "channel.txt", launch.given, launch.out])]
"""
SEGMENT = """
import json
import sys
from pathlib import Path

import cv2

method, weights, channel, given, out = sys.argv[1:]
images, found = [], []
for number, name in enumerate((Path(given) / "images.txt").read_text().splitlines()):
    picture = cv2.imread(str(Path(given) / (name + ".png")))[..., ::-1]
    light = (picture[..., int(Path(channel).read_text())] > float(Path(weights).read_text())).astype("uint8")
    if method == "toy_masks":
        (Path(out) / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(Path(out) / (name + ".png")), 255 * light)
    else:
        images.append({"id": number, "file_name": name + ".png", "height": len(light), "width": len(light[0])})
        for x, y, w, h, _ in cv2.connectedComponentsWithStats(light)[2][1:].tolist():
            found.append({"id": len(found), "image_id": number, "category_id": 1, "bbox": [x, y, w, h], "score": 0.9})
if images:
    categories = [{"id": 1, "name": "oyster"}]
    Path(out).write_text(json.dumps({"images": images, "annotations": found, "categories": categories}))
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
    files = {
        "system.toml": MANIFEST.format(commit=commit, align=align),
        "CMakeLists.txt": CMAKE,
        "edits.toml": EDITS,
        "configure.py": CONFIGURE.format(answer=str(answer)),
    }
    return _package(root, files)


def toy_image_package(root: Path) -> Path:
    """The same with a system of pictures, which is a script and needs no building."""
    files = {"system.toml": IMAGE_MANIFEST, "segment.py": SEGMENT, "configure.py": IMAGE_CONFIGURE}
    return _package(root, files)


def forget() -> None:
    """What is known of systems in this process, of which every test has its own."""
    systems.cache_clear()
    for name in [name for name in sys.modules if name.startswith("toy_systems")]:
        del sys.modules[name]


def _package(root: Path, files: Mapping[str, str]) -> Path:
    folder = root / "toy_systems" / "toy"
    folder.mkdir(parents=True)
    for place in (folder.parent, folder):
        (place / "__init__.py").touch()
    for name, text in files.items():
        (folder / name).write_text(text)
    metadata = root / "toy_systems-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-systems\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[oysterbench.systems]\ntoy = toy_systems.toy\n")
    return folder
