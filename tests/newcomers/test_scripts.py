"""Four newcomers' ways, from an empty folder to a result: each script of docs/paths is run as it stands there, with
only the extras that it installs."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import click
import cv2
import numpy as np
import pytest
from packaging.requirements import Requirement

from oysterbench.cli.main import main
from tests.helpers.extras import only
from tests.helpers.paths import ROOT

SCRIPTS = sorted((ROOT / "docs" / "paths").glob("*.sh"))
MOST_COMMANDS = 6
LIMIT_S = 1800
PIP = """#!/bin/sh
echo "$@" >> "$(dirname "$0")/asked"
"""


def commands(path: Path) -> list[str]:
    """The lines that are typed."""
    return [line for line in path.read_text().splitlines() if line and not line.startswith("#")]


def extras(path: Path) -> set[str]:
    """Those of what a script installs."""
    words = shlex.split(commands(path)[0])
    assert words[:2] == ["pip", "install"]
    return set(Requirement(words[2]).extras)


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_has_a_line_on_what_it_is_and_six_commands_at_most(path):
    assert path.read_text().startswith("# ")
    assert len(commands(path)) <= MOST_COMMANDS


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_types_commands_and_options_that_there_are(path):
    found = re.findall(r"oysterbench ((?:[a-z-]+|[^&|>\n])+)", "\n".join(commands(path)))
    typed = [shlex.split(text) for text in found if not text.startswith("[")]
    assert typed
    for words in typed:
        group: click.Command = main
        context = click.Context(main, info_name="oysterbench", **main.context_settings)
        while isinstance(group, click.Group) and words:
            if words[0].startswith("-"):  # options of the group stand before the command
                group.parse_args(click.Context(group, parent=context), list(words))
                break
            command = group.get_command(context, words[0])
            assert command is not None, words
            group, words = command, words[1:]
        if not isinstance(group, click.Group):
            group.make_context(group.name, words, parent=context)


def run(path: Path, folder: Path, home: Path) -> str:
    """Run a script in a folder, with the extras alone that it asks for: what it prints."""
    done = subprocess.run(
        ["bash", "-euo", "pipefail", str(path)],
        cwd=folder,
        env=prepared(path, folder, home),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    return done.stdout


def prepared(path: Path, folder: Path, home: Path) -> dict[str, str]:
    """What a newcomer brings along: an empty folder, this package by `pip`, a home."""
    bin_folder = folder.parent / "bin"
    bin_folder.mkdir()
    (bin_folder / "pip").write_text(PIP)
    (bin_folder / "pip").chmod(0o755)
    folder.mkdir()
    places = (str(bin_folder), str(Path(sys.executable).parent), os.environ["PATH"])
    clean = {key: value for key, value in only(extras(path), folder.parent / "start").items() if "OYSTERB" not in key}
    return clean | {"PATH": os.pathsep.join(places), "OYSTERBENCH_HOME": str(home)}


def script(name: str) -> Path:
    return ROOT / "docs" / "paths" / f"{name}.sh"


@pytest.mark.slow
def test_a_program_in_cpp_is_run_on_a_dive_and_compared_with_a_baseline(minis, tmp_path):
    if shutil.which("c++") is None:
        pytest.skip("c++ is not installed")
    folder, copied = tmp_path / "empty", ROOT / "docs" / "paths" / "my_slam.cpp"
    source = script("slam")
    lines = [f"cp {shlex.quote(str(copied))} ."]
    printed = run(_with(source, lines, tmp_path), folder, minis)
    (result,) = json.loads((folder / "mine" / "results.json").read_text())["results"]
    assert result["failure"] is None
    assert result["metrics"]["coverage"] > 0.95
    assert 0 < result["metrics"]["score"] < 0.9
    assert "my_slam" in printed
    assert "gtsam_vi" in printed
    assert (folder / "comparison.html").is_file()


@pytest.mark.slow
def test_a_network_is_trained_on_one_reef_and_scored_on_another(minis, tmp_path):
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")
    folder, copied = tmp_path / "empty", ROOT / "docs" / "paths" / "my_net.py"
    run(_with(script("segmentation"), [f"cp {shlex.quote(str(copied))} ."], tmp_path), folder, minis)
    results = json.loads((folder / "mine" / "results.json").read_text())["results"]
    iou = {result["method"]: result["metrics"]["iou"] for result in results}
    assert iou["my_net"] > 0.3
    assert 0 < iou["colour"] < 1
    assert (folder / "comparison.html").is_file()


@pytest.mark.slow
def test_oysters_of_a_video_are_counted_with_the_weights_of_oysterbench(tmp_path):
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")
    folder, video = tmp_path / "empty", tmp_path / "dive.mp4"
    _write_video(video)
    source = _with(script("counting"), [f"cp {shlex.quote(str(video))} ."], tmp_path)
    run(source, folder, tmp_path / "home")
    assert (folder / "counted" / "index.html").is_file()
    assert len((folder / "counted" / "images.csv").read_text().splitlines()) > 1


@pytest.mark.slow
def test_a_board_is_served_and_a_submission_scored_and_shown(minis, tmp_path, free_port):
    folder, source = tmp_path / "empty", script("hosting")
    text = (
        source.read_text()
        .replace(":8000", f":{free_port}")
        .replace("serve --board board", f"serve --port {free_port} --board board")
    )
    (tmp_path / "hosting.sh").write_text(text)
    with (tmp_path / "printed").open("w+") as printed, (tmp_path / "told").open("w+") as told:
        process = subprocess.Popen(
            ["bash", "-euo", "pipefail", str(tmp_path / "hosting.sh")],
            env=prepared(source, folder, minis),
            cwd=folder,
            stdout=printed,
            stderr=told,
            start_new_session=True,
        )
        try:
            process.wait(LIMIT_S)
            assert answers(f"http://127.0.0.1:{free_port}/")
        finally:  # the server goes on
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    found = (tmp_path / "printed").read_text()
    assert process.returncode == 0, found[-2000:] + (tmp_path / "told").read_text()[-3000:]
    assert "dead_reckoning on slam-mini: done" in found
    assert "reef lab" in found.rpartition("slam on slam-mini")[2]  # the board, in the end


def answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=5) as answer:
            return bool(answer.status == 200)
    except (urllib.error.URLError, OSError):
        return False


def _with(path: Path, brought: list[str], folder: Path) -> Path:
    """A script after what its user has brought along into the folder."""
    first, *rest = commands(path)
    made = folder / path.name
    made.write_text("\n".join([first, *brought, *rest]) + "\n")
    return made


def _write_video(path: Path) -> None:
    """Two seconds of light discs on dark ground, as people film."""
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (160, 120))
    for k in range(20):
        frame = np.full((120, 160, 3), 30, dtype=np.uint8)
        cv2.circle(frame, (40 + 3 * k, 60), 12, (200, 210, 190), -1)
        film.write(frame)
    film.release()
