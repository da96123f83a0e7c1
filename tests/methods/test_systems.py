"""Published systems: found, built from their sources, configured, run by name, and told apart when they change."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.methods.systems import building, find_system, split_reference, systems
from oysterbench.methods.systems.container import containerfile
from oysterbench.methods.systems.manifest import read_system
from oysterbench.results.records import read_results
from tests.helpers.command import run
from tests.helpers.toy_system import forget, toy_package, toy_repository

needs_tools = pytest.mark.skipif(
    not (shutil.which("git") and shutil.which("cmake")), reason="git and cmake are not installed"
)


@pytest.fixture
def answer(tmp_path, dive_file):
    """The true path, 2 times as large."""
    truth = oysterbench.open(dive_file).truth()
    large = Trajectory(truth.stamps_ns, 2 * truth.positions, truth.quaternions)
    write_tum(tmp_path / "answer.tum", large)
    return tmp_path / "answer.tum"


@pytest.fixture
def toy(tmp_path, answer, monkeypatch):
    """A system that is not built, and the repository of its source; both are found by what is started here."""
    commit = toy_repository(tmp_path / "upstream")
    folder = toy_package(tmp_path / "python", commit, answer, align="sim3")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "python"))
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.syspath_prepend(str(tmp_path / "python"))
    forget()
    yield folder
    forget()


@needs_tools
def test_a_system_is_built_and_run_by_name(toy, dive_file, tmp_path):
    refused = run("run", "toy", "--on", dive_file, "--out", tmp_path / "out")
    assert refused.returncode == 1
    assert refused.stderr == "oysterbench: toy is not built here; type: oysterbench systems build toy\n"

    done = run("systems", "build", "toy", "--source", tmp_path / "upstream")
    assert done.returncode == 0, done.stderr
    place = find_system("toy").place
    assert "ready" in (place / "build" / "toy").read_text()
    assert not (place / "source" / "unused").exists()
    listed = json.loads(run("systems", "--json").stdout)
    assert next(row for row in listed if row["method"] == "toy")["state"].startswith("built")

    done = run("run", "toy", "--on", dive_file, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "out" / "results.json")
    assert record.settings["align"] == "sim3"  # as its manifest says
    assert record.info["run"]["limit_s"] == 1.5 * 600
    assert record.metrics["ate_rmse_m"] < 1e-6
    assert record.method_settings == {"method": "toy", "word": "ready", "gain": 1.0}
    assert record.info["run"]["versions"]["commit"] == find_system("toy").description.commit
    assert len(record.info["log_sha256"]) == 64
    assert list(record.info["configuration_sha256"]) == ["word.txt"]
    assert record.info["run"]["command"][0] == str(place / "build" / "toy")
    assert record.metrics["peak_memory_mb"] < 40  # a shell's, and not that of whatever wrote word.txt
    assert record.metrics["cpu_s"] < 0.2

    others = ("--align", "posyaw", "--timeout", 60)
    given = run("run", "toy", "--on", dive_file.parent, "--out", tmp_path / "se3", *others)
    assert given.returncode == 0, given.stderr
    (record,) = read_results(tmp_path / "se3" / "results.json")
    assert record.settings["align"] == "posyaw"
    assert record.info["run"]["limit_s"] == 60
    assert record.metrics["ate_rmse_m"] > 1e-3


@needs_tools
@pytest.mark.slow
def test_a_changed_configuration_or_recipe_is_another_run(toy, dive_file, tmp_path):
    building.build(find_system("toy"), [tmp_path / "upstream"], announce=lambda text: None)
    words = ("run", "toy", "--on", dive_file, "--out", tmp_path / "out")
    assert run(*words).returncode == 0
    with open(toy / "configure.py", "a") as file:
        file.write("# changed\n")
    changed = run(*words)
    assert changed.returncode == 1
    assert "rerun it with --again" in changed.stderr
    with open(toy / "CMakeLists.txt", "a") as file:
        file.write("# changed\n")
    assert "is not built here" in run(*words).stderr


@needs_tools
def test_what_a_build_says_last_is_told_with_its_log(toy, tmp_path):
    with open(toy / "CMakeLists.txt", "a") as file:
        file.write('message(FATAL_ERROR "no such library")\n')
    done = run("systems", "build", "toy", "--source", tmp_path / "upstream")
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert "no such library" in last
    assert last.endswith(str(find_system("toy").place / "build.log"))
    assert building.built(find_system("toy")) is None


@needs_tools
def test_an_edit_of_a_text_that_is_not_there_is_refused(toy, tmp_path):
    (toy / "edits.toml").write_text(
        '[[edit]]\nfile = "src/toy.sh"\nfind = "never there"\nreplace = ""\nreason = "a test"\n'
    )
    with pytest.raises(MethodError, match=r"src/toy.sh of the source has no text 'never there'"):
        building.build(find_system("toy"), [tmp_path / "upstream"], announce=lambda text: None)


@needs_tools
def test_submodules_are_put_where_the_source_expects_them_from_the_clone_that_has_them(toy, tmp_path):
    commit = toy_repository(tmp_path / "other", script="echo another\n")
    with open(toy / "system.toml", "a") as file:
        file.write(f'\n[submodules."external/other"]\nsource = "https://x.example/x"\ncommit = "{commit}"\n')
        file.write('folders = ["src"]\n')
    forget()
    with pytest.raises(MethodError, match=rf"needs https://x.example/x at {commit}, which is in none of"):
        building.build(find_system("toy"), [tmp_path / "upstream"], announce=lambda text: None)
    building.build(find_system("toy"), [tmp_path / "upstream", tmp_path / "other"], announce=lambda text: None)
    source = find_system("toy").place / "source"
    assert (source / "external" / "other" / "src" / "toy.sh").read_text() == "echo another\n"
    assert not (source / "external" / "other" / "unused").exists()
    assert (source / "src" / "toy.sh").exists()


@needs_tools
def test_other_words_or_options_in_the_manifest_are_no_other_build(toy, tmp_path):
    building.build(find_system("toy"), [tmp_path / "upstream"], announce=lambda text: None)
    text = (toy / "system.toml").read_text()
    (toy / "system.toml").write_text(text.replace("default = 1.0", "default = 2.0"))
    forget()
    assert building.built(find_system("toy")) is not None
    (toy / "system.toml").write_text(text.replace('program = "toy"', 'program = "toy"\npython = ["numpy"]'))
    forget()
    assert building.built(find_system("toy")) is None


def test_packages_that_are_missing_are_named(toy, monkeypatch):
    monkeypatch.setattr(building, "missing_packages", lambda packages: ["libfoo-dev", "libbar-dev"])
    with pytest.raises(MethodError, match="type: sudo apt-get install libfoo-dev libbar-dev"):
        building.build(find_system("toy"))


def test_without_the_renderer_a_system_that_renders_is_refused_before_it_is_compiled(toy, tmp_path, monkeypatch):
    text = (toy / "system.toml").read_text()
    (toy / "system.toml").write_text(text.replace('program = "toy"', 'program = "toy"\nrenders = true'))
    forget()
    monkeypatch.setattr(building, "missing_packages", lambda packages: [])
    monkeypatch.setattr(building, "RENDERER", "nowhere_to_be_found")
    with pytest.raises(MethodError, match=r"toy renders sequences .*; type: pip install 'oysterbench\[render\]'$"):
        building.build(find_system("toy"), [tmp_path / "upstream"], announce=lambda text: None)
    assert building.built(find_system("toy")) is None
    assert 'OYSTERBENCH="oysterbench[render,slam]==' in containerfile(find_system("toy"))


def test_options_are_those_of_the_manifest(toy):
    system, name, options = split_reference("toy[gain=2]")
    assert (system.name, name, options) == ("toy", "toy[gain=2]", {"word": "ready", "gain": 2.0})
    assert split_reference("gtsam_vi") is None
    with pytest.raises(MethodError, match="has no option 'gian'; did you mean gain"):
        split_reference("toy[gian=2]")
    with pytest.raises(MethodError, match="expected one of ready, wrong, got never"):
        split_reference("toy[word=never]")


def test_options_of_which_only_the_range_is_known_have_values_of_its_kind(toy):
    with open(toy / "system.toml", "a") as file:
        file.write("\n[options.levels]\nrange = [2, 4]\n\n[options.sigma]\nrange = [0.5, 2.0]\n")
    forget()
    _, _, options = split_reference("toy[levels=7,sigma=1]")
    assert (options["levels"], options["sigma"]) == (7, 1.0)
    for wrong in ("abc", "2.9"):
        with pytest.raises(MethodError, match=f"option 'levels' .*: expected a whole number, such as 2, got '{wrong}'"):
            split_reference(f"toy[levels={wrong}]")
    with pytest.raises(MethodError, match=r"option 'sigma' .*: expected a number, such as 0\.5, got 'abc'"):
        split_reference("toy[sigma=abc]")


def test_a_wrong_manifest_is_named_with_file_and_key(toy):
    text = (toy / "system.toml").read_text()
    (toy / "system.toml").write_text(text.replace('sensors = ["mono"]', 'sensors = ["nose"]'))
    with pytest.raises(MethodError, match=r"system.toml: .*'nose'.*sensors"):
        read_system("toy", toy)
    (toy / "system.toml").write_text(text.replace("align", "options = { none = 1 }\nalign"))
    with pytest.raises(MethodError, match=r"methods.toy.options: the system has no option 'none'"):
        read_system("toy", toy)
    (toy / "system.toml").write_text(text.replace("limit_factor = 1.5", "limit_factor = 0.0"))
    with pytest.raises(MethodError, match=r"system.toml: Expected `float` > 0.0 - at `\$.methods\[...\].limit_factor`"):
        read_system("toy", toy)


def test_a_system_that_fails_has_its_last_words(toy, dive_file, tmp_path):
    if not (shutil.which("git") and shutil.which("cmake")):
        pytest.skip("git and cmake are not installed")
    building.build(find_system("toy"), [tmp_path / "upstream"], announce=lambda text: None)
    done = run("run", "toy[word=wrong]", "--on", dive_file, "--out", tmp_path / "out")
    assert done.returncode == 1
    assert "toy begins" in done.stderr


@needs_tools
@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise MethodError('Toy: expected a fisheye')", "exit status 1; last output: Toy: expected a fisheye"),
        ("raise SystemExit", "its configure.py ended before it returned a command line"),
    ],
)
def test_a_configuration_that_cannot_be_written_fails_the_run_and_costs_the_system_nothing(
    toy, dive_file, tmp_path, body, said
):
    building.build(find_system("toy"), [tmp_path / "upstream"], announce=lambda text: None)
    imported = "from oysterbench.core.errors import MethodError"
    (toy / "configure.py").write_text(f"{imported}\n\ndef command(launch):\n    {body}\n")
    assert run("run", "toy", "--on", dive_file, "--out", tmp_path / "out").returncode == 1
    (record,) = read_results(tmp_path / "out" / "results.json")
    assert record.failure is not None
    assert record.failure.endswith(f": {said}")
    assert "cpu_s" not in record.metrics


def test_every_system_has_a_container_recipe():
    for system in systems().values():
        text = containerfile(system)
        assert f"oysterbench systems build {system.name}" in text
        assert "not on /data itself" in text  # which would hide the build
        assert all(package in text for package in system.description.packages)
        assert text.index("\nENV PIP_NO_CACHE_DIR=1\n") < text.index("pip install")  # a system's own packages included
        assert ("ARG PIP_EXTRA_INDEX_URL\n" in text) == (system.name == "segformer")
        configured = import_module(f"{system.module}.configure")
        assert system.description.renders == hasattr(configured, "prepare") == ("[render," in text)


BUILDS = """
import signal, sys
from oysterbench.cli.interrupts import heed_termination
from oysterbench.methods.systems import building, find_system

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run without a terminal
heed_termination()
step = f"sleep 600 & echo $$ $! > {sys.argv[1]}; echo '[1/2] begun'; wait"
with open("/dev/null", "wb") as log, open(sys.argv[1] + ".told", "w") as told:
    building._call(find_system("dso"), ["sh", "-c", step], log, lambda text: print(text, file=told, flush=True))
"""


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_build_that_is_interrupted_ends_its_step_at_once_with_all_that_it_started(sign, tmp_path):
    began = tmp_path / "began"
    with subprocess.Popen([sys.executable, "-c", BUILDS, began], stderr=subprocess.PIPE, text=True) as build:
        wait_for(lambda: tmp_path.joinpath("began.told").is_file() and tmp_path.joinpath("began.told").read_text())
        build.send_signal(sign)
        said = build.communicate(timeout=30)[1]
    assert ("KeyboardInterrupt" if sign == signal.SIGINT else "Terminated") in said
    for number in began.read_text().split()[:2]:
        wait_for(lambda number=number: has_ended(number))


def has_ended(number):
    """Whether a process has ended, be it that nobody has asked for its exit status."""
    try:
        return Path("/proc", number, "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def wait_for(happens):
    begun = time.monotonic()
    while not happens():
        assert time.monotonic() < begun + 60
        time.sleep(0.02)
