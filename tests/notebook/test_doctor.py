"""What the doctor finds: what is missing is no fault, what is set and does not work is, and nothing heavy is loaded."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib

import pytest
from packaging.requirements import Requirement

import oysterbench
from oysterbench.notebook.doctor import installed, machine
from oysterbench.notebook.doctor.finding import Finding
from oysterbench.notebook.doctor.installed import EXTRAS, OF_OTHERS, extra_finding
from oysterbench.recipe import load_split
from oysterbench.simulation.generate import split_folder
from tests.helpers.command import assert_one_line, run
from tests.helpers.paths import ROOT


@pytest.fixture(autouse=True)
def nothing_set(home, monkeypatch):
    """An empty home, and no variable of this program."""
    for name in list(os.environ):
        if name.startswith("OYSTERBENCH_") and name != "OYSTERBENCH_HOME":
            monkeypatch.delenv(name)


def found(name, section=None):
    """What the doctor finds of something."""
    findings = [one for one in oysterbench.doctor().findings if one.name == name and section in (None, one.section)]
    assert findings, name
    return findings[0]


def test_what_is_missing_is_no_fault():
    done = run("doctor")
    assert done.returncode == 0, done.stderr
    assert "nothing is broken" in done.stderr
    for part in ("program", "extras", "machine", "data", "hub", "systems", "running"):
        assert f"\n{part}\n" in f"\n{done.stdout}"
    assert found("splits") == Finding("data", "splits", "missing", "none here yet", "oysterbench render slam-mini")
    assert found("hub").state == "missing"
    assert found("weights unet_small").advice.startswith("oysterbench train unet_small")
    assert found("weights unet").detail.endswith(", part of oysterbench")


def test_findings_are_printed_as_json_and_nothing_else():
    done = run("doctor", "--json")
    document = json.loads(done.stdout)
    assert document["broken"] == 0
    assert {one["state"] for one in document["findings"]} <= {"ok", "poor", "missing"}
    assert set(document["findings"][0]) == {"section", "name", "state", "detail", "advice"}


@pytest.mark.parametrize(
    ("variable", "value", "pattern"),
    [
        ("OYSTERBENCH_HUB_KEY", "abc", "key: OYSTERBENCH_HUB_KEY"),
        ("OYSTERBENCH_HUB", "/no/such/tree", "hub: /no/such/tree: no such folder"),
        ("OYSTERBENCH_HUB", "ftp://hub.example", "hub: ftp://hub.example: expected http://"),
        ("OYSTERBENCH_SALT_FILE", "/no/such/salt", "salt: OYSTERBENCH_SALT_FILE: /no/such/salt"),
        ("OYSTERBENCH_EXPORTS_GB", "many", "exports: OYSTERBENCH_EXPORTS_GB: expected the maximum size"),
        ("OYSTERBENCH_UNET", "/no/such.pt", "weights unet: OYSTERBENCH_UNET = /no/such.pt: no such file"),
        ("OYSTERBENCH_HOME", "/proc/1/mem/home", "home: "),
    ],
)
def test_what_is_set_and_does_not_work_is_one_line_and_status_1(variable, value, pattern, monkeypatch):
    monkeypatch.setenv(variable, value)
    done = run("doctor", "--json")
    assert json.loads(done.stdout)["broken"] == 1
    done.stdout = ""
    assert_one_line(done, f"broken: {pattern}")


def test_a_hub_file_that_is_no_toml_is_broken(home):
    home.mkdir()
    (home / "hub.toml").write_text("url = ")
    assert found("hub").state == "broken"
    assert "not valid TOML" in found("hub").detail


def test_a_hub_with_its_key_is_there_and_without_it_poor(tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_HUB", str(tmp_path))
    assert "holds no published tree" in found("hub").detail
    (tmp_path / "index.json").touch()
    assert found("hub").state == "ok"
    assert found("key").state == "poor"
    monkeypatch.setenv("OYSTERBENCH_HUB_KEY", "9f" * 32)
    assert found("key").state == "ok"


def test_misspelled_variables_are_named(monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_HOM", "/data")
    assert found("OYSTERBENCH_HOM") == Finding(
        "hub", "OYSTERBENCH_HOM", "poor", "nothing reads it; did you mean OYSTERBENCH_HOME?"
    )


def test_a_split_is_told_of_with_what_was_begun(home):
    folder = split_folder(load_split("seg-mini"))
    for path in (
        folder / "mini-01.mcap",
        folder / ".parts" / "mini-02-x" / "part",
        folder.parent / "1.0-old" / "a.mcap",
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(2_000_000))
    one = found("seg-mini")
    assert one.detail == "1 of 2 sequences, 2 MB; a render was begun; 1 of other versions, 2 MB"
    assert one.advice == "oysterbench render seg-mini"


def test_every_extra_is_described():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(EXTRAS) == set(extras) - set(OF_OTHERS)
    named = {one.name for one in installed.look_at_packages() if one.section == "extras"}
    assert named <= set(EXTRAS)


def test_an_extra_is_whole_or_says_what_to_type(monkeypatch):
    here = {"torch": "2.13.0+cpu", "matplotlib": "3.2"}
    monkeypatch.setattr(installed, "installed_version", here.get)
    whole = extra_finding("learn", [Requirement("torch>=2.10")])
    assert (whole.state, whole.advice) == ("ok", "")
    assert whole.detail.endswith("torch 2.13.0+cpu")
    part = extra_finding("learn", [Requirement("torch>=2.10"), Requirement("efficientnet>=0.1")])
    assert (part.state, part.advice) == ("missing", "pip install 'oysterbench[learn]'")
    assert part.detail.endswith("without efficientnet")
    old = extra_finding("learn", [Requirement("torch>=2.10"), Requirement("matplotlib>=3.8")])
    assert (old.state, old.advice) == ("broken", "pip install -U 'oysterbench[learn]'")
    assert old.detail.endswith("matplotlib 3.2; expected matplotlib>=3.8")


def test_a_gpu_is_told_of_with_what_can_use_it(monkeypatch):
    monkeypatch.setattr(machine, "cuda_devices", lambda: (["NVIDIA H100 with 85.0 GB"], ""))
    monkeypatch.setattr(machine, "installed_version", {"torch": "2.13.0+cpu", "warp-lang": "1.19.0"}.get)
    asked: list[str] = []
    monkeypatch.setattr(machine, "ask", lambda question: bool(asked.append(question)) or len(asked) > 1)
    first = {one.name: one.state for one in machine.gpus()}
    assert first == {"GPU": "ok", "GPU, torch": "poor", "GPU, warp-lang": "poor"}
    assert {one.name: one.state for one in machine.gpus()}["GPU, warp-lang"] == "ok"
    assert all("warp" in question for question in asked), "what is built for processors alone is not asked"


def test_a_program_that_says_so_can_use_a_gpu():
    assert machine.ask("print('greeting'); print(True)")
    assert not machine.ask("print(False)")
    assert not machine.ask("import no_such_module")


def test_little_room_is_poor_and_no_fault(monkeypatch):
    monkeypatch.setattr(machine.resource, "getrlimit", lambda what: (256, 4096))
    monkeypatch.setattr(machine, "LEAST_SHARED", 1 << 60)
    findings = {one.name: one for one in machine.look_at_machine()}
    assert (findings["open files"].state, findings["open files"].advice) == ("poor", "ulimit -n 1024")
    assert findings["shared memory"].state == "poor"


def test_nothing_heavy_is_loaded_for_it():
    code = """
import sys, oysterbench
checkup = oysterbench.doctor()
assert not {"torch", "warp", "gtsam", "matplotlib", "sqlalchemy"} & set(sys.modules)
print(checkup)
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert "\n  ok      packages: " in done.stdout


def test_it_shows_itself_in_a_notebook():
    checkup = oysterbench.doctor()
    assert "nothing is broken" in checkup._repr_html_()
    assert checkup.broken == ()
