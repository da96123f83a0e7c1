"""Container files say what is so: what they copy is there, what they install is offered, what they start exists."""

from __future__ import annotations

import re
import tomllib

import pytest
from click import Context

from oysterbench.cli.main import main
from tests.helpers.paths import ROOT

FILES = ("containers/Containerfile", "leaderboard/hosting/Containerfile")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
IGNORED = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and line[0] not in "#!"]


def steps(name):
    """(instruction, the rest) of each line, continued ones as one."""
    text = re.sub(r"\\\n\s*", " ", (ROOT / name).read_text())
    return [line.split(maxsplit=1) for line in text.splitlines() if line.strip() and not line.startswith("#")]


@pytest.mark.parametrize("name", FILES)
def test_what_is_copied_is_there_and_reaches_the_builder(name):
    copied = [source for step, rest in steps(name) if step == "COPY" for source in rest.split()[:-1]]
    assert copied
    for source in copied:
        assert (ROOT / source).exists(), source
        assert source.split("/")[0] not in IGNORED


@pytest.mark.parametrize("name", FILES)
def test_all_packages_and_what_a_wheel_is_made_of_are_copied(name):
    copied = {source for step, rest in steps(name) if step == "COPY" for source in rest.split()[:-1]}
    needed = {*PROJECT["tool"]["setuptools"]["package-dir"].values(), "pyproject.toml"}
    needed |= {PROJECT["project"]["readme"], ".ci/constraints.txt"}
    needed |= {text.removesuffix("/*") for text in PROJECT["project"]["license-files"]}
    assert "." in copied or needed <= copied


@pytest.mark.parametrize("name", FILES)
def test_the_extras_installed_are_offered_and_pinned(name):
    installs = [rest for step, rest in steps(name) if step == "RUN" and "pip install" in rest]
    assert installs
    for install in installs:
        assert ".ci/constraints.txt" in install
        extras = re.search(r"\[([\w,]+)\]", install)
        assert extras is not None
        assert {*extras[1].split(",")} <= {*PROJECT["project"]["optional-dependencies"]}


def test_each_target_ends_as_a_user_without_rights_in_a_folder_of_its_own():
    targets, found = {}, None
    for step, rest in steps(FILES[0]):
        if step == "FROM":
            found = targets.setdefault(rest.split(" AS ")[1], [])
        found.append((step, rest))
    assert [*targets] == ["base", "cpu", "cuda"]
    for target in ("cpu", "cuda"):
        assert ("USER", "oysterbench") in [tuple(step) for step in targets[target]]
    assert any("NVIDIA_VISIBLE_DEVICES" in rest for _, rest in targets["cuda"])
    assert any("whl/cpu" in rest for _, rest in targets["cpu"])


def test_the_command_that_a_container_starts_exists():
    said = dict(steps(FILES[0]))
    assert said["ENTRYPOINT"] == '["oysterbench"]'
    (command,) = re.findall(r'"(\w+)"', said["CMD"])
    assert main.get_command(Context(main), command) is not None
    assert "oysterbench" in PROJECT["project"]["scripts"]


def test_all_extras_but_those_for_developers_are_in_all():
    extras = PROJECT["project"]["optional-dependencies"]
    (every,) = extras["all"]
    assert {*re.findall(r"[\w]+", every.partition("[")[2])} == {*extras} - {"all", "docs", "dev"}


def test_the_page_names_commands_and_targets_that_there_are():
    page = (ROOT / "containers" / "README.md").read_text()
    assert {*re.findall(r"--target (\w+)", page)} == {"cpu", "cuda"}
    for command in re.findall(r"oysterbench(?:-cuda)? (\w+)(?: slam| NAME|\n|`)", page):
        assert main.get_command(Context(main), command) is not None, command
    for link in re.findall(r"\]\((\.\./[^)]+)\)", page):
        assert (ROOT / "containers" / link).exists()
