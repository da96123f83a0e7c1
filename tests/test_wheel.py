"""The wheel, installed into an empty environment and used far from the checkout, carries all that it needs."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from oysterbench.version import VERSION
from tests.helpers.paths import ROOT

EXTRAS = "render,slam,learn"
PARTS = ("datasets", "baselines", "leaderboard", "oysterbench", ".ci", "pyproject.toml", "LICENSE", "LICENSES")
"""Of the checkout, that a wheel is made of."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy, so that nothing is left in the checkout."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for part in PARTS:
        if (ROOT / part).is_dir():
            shutil.copytree(ROOT / part, source / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / part, source / part)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", out]
    subprocess.run([*build, source], check=True, capture_output=True)
    (found,) = out.glob("*.whl")
    return found


@pytest.mark.slow
def test_the_wheel_has_data_of_every_kind_and_nothing_of_the_checkout_only(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert wheel.name == f"oysterbench-{VERSION}-py3-none-any.whl"
    for wanted in (
        "oysterbench/py.typed",
        "oysterbench/core/templates/",
        "oysterbench/hub/templates/",
        "oysterbench/report/templates/",
        "oysterbench/report/viewer/templates/",
        "oysterbench_datasets/splits/slam-val.toml",
        "oysterbench_datasets/rigs/",
        "oysterbench_datasets/gallery/",
        "oysterbench_datasets/manifests/slam-mini-1.0.json",
        "oysterbench_datasets/models/unet.pt",
        "oysterbench_datasets/models/unet.json",
        "oysterbench_baselines/external/openvins/",
        "oysterbench_leaderboard/records/",
        "oysterbench_leaderboard/curves/",
        "oysterbench_leaderboard/hosting/Containerfile",
        "oysterbench_leaderboard/site/static/",
        "oysterbench_leaderboard/site/templates/",
        "oysterbench_leaderboard/submissions/templates/",
    ):
        assert any(name.startswith(wanted) for name in names), wanted
    tops = {name.partition("/")[0] for name in names}
    packages = {"oysterbench", "oysterbench_datasets", "oysterbench_baselines", "oysterbench_leaderboard"}
    assert tops == packages | {f"oysterbench-{VERSION}.dist-info"}


class Installed:
    """An environment of its own, and a folder far from the checkout, with a home in it."""

    def __init__(self, folder: Path, wheel: Path) -> None:
        self.bin, self.folder = folder / "env" / "bin", folder / "work"
        self.folder.mkdir()
        clean = {key: value for key, value in os.environ.items() if not key.startswith(("OYSTERBENCH", "PYTHON"))}
        self.environment = clean | {"OYSTERBENCH_HOME": str(folder / "home"), "OMP_NUM_THREADS": "1"}
        subprocess.run([sys.executable, "-m", "venv", folder / "env"], check=True)
        probe = self.run("pip", "download", "--quiet", "--no-deps", "--dest", folder / "probe", "click", code=None)
        if probe.returncode:
            pytest.skip("no package index can be reached")
        pins = ("--constraint", ROOT / ".ci" / "constraints.txt")
        self.run("pip", "install", "--quiet", "--no-compile", *pins, f"{wheel}[{EXTRAS}]")

    def run(self, program, *arguments, code=0):
        done = subprocess.run(
            [str(self.bin / program), *map(str, arguments)],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert code is None or done.returncode == code, done.stderr[-3000:]
        return done


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    return Installed(tmp_path_factory.mktemp("installed"), wheel)


@pytest.mark.slow
def test_the_demo_renders_what_was_released_and_two_methods_localise_on_it(installed):
    assert installed.run("oysterbench", "--version").stdout.strip().endswith(VERSION)
    results = json.loads(installed.run("oysterbench", "eval", "--track", "slam", "--json").stdout)["results"]
    assert len({result["method"] for result in results}) >= 2
    checked = json.loads(installed.run("oysterbench", "verify", "slam-mini", "--json").stdout)["files"]
    assert [row["state"] for row in checked] == ["right"]
    assert installed.run("oysterbench", "render", "slam-mini").stderr.endswith("as released, 1 of 1 files\n")


@pytest.mark.slow
def test_the_board_comes_with_its_records(installed):
    boards = json.loads(installed.run("oysterbench", "leaderboard", "--json").stdout)
    assert boards
    assert "all intact" in installed.run("oysterbench", "leaderboard", "verify").stdout
    assert installed.run("oysterbench", "splits").stdout.count("slam-") >= 4
    assert "openvins" in installed.run("oysterbench", "systems").stdout
    doctor = installed.run("oysterbench", "doctor").stdout
    assert all(section in doctor for section in ("program", "machine", "data", "hub"))


TORCH = """
import oysterbench, torch
from torch.utils.data import DataLoader
windows = oysterbench.torch.WindowDataset("slam-mini", length=3)
frames = oysterbench.torch.FrameDataset("slam-mini", layers=("class",))
batch = next(iter(DataLoader(windows, batch_size=2)))
one = frames[0]
print(len(windows) > 0, len(frames) > 0, batch["imu"].ndim, one["image"].shape[0], oysterbench.__file__)
"""


@pytest.mark.slow
def test_data_sets_for_torch_read_the_split(installed):
    done = installed.run("python", "-c", TORCH).stdout.split()
    assert done[:4] == ["True", "True", "4", "3"]
    assert str(ROOT) not in done[4]
