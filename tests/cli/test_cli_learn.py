"""Commands that others bring: found by their entry points, loaded when needed, and named where they cannot be."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from oysterbench.cli.learn import Installed, experiment, train
from oysterbench.cli.main import main


class Point:
    """An entry point of the shape that a group reads."""

    def __init__(self, value):
        self.value = value

    def load(self):
        if isinstance(self.value, Exception):
            raise self.value
        return self.value


@pytest.fixture
def group(monkeypatch):
    """A group as `train` is one, of commands that a test gives it, in the whole command line."""

    def make(**commands):
        monkeypatch.setattr(Installed, "found", lambda self: {k: Point(v) for k, v in commands.items()})
        return lambda *words: CliRunner().invoke(main, ["train", *words])

    return make


def test_what_is_installed_is_listed_and_run(group):
    @click.command("mine", short_help="My own.")
    @click.option("--name")
    def mine(name):
        print(f"trained {name}")

    run = group(mine=mine)
    assert "mine  My own." in run("--help").stdout
    assert run("mine", "--name", "it").stdout == "trained it\n"
    assert "No such command 'other'.\n" in run("other").stderr
    assert "No such command 'mien'. Did you mean mine?" in run("mien").stderr


def test_a_package_that_is_missing_is_named_with_what_to_install(group):
    @click.command("late")
    def late():
        raise ModuleNotFoundError("No module named 'torch'")

    run = group(late=late, early=ModuleNotFoundError("No module named 'torch'"), odd=42)
    for name in ("late", "early"):
        result = run(name)
        assert result.exit_code == 1
        advice = "install what it needs, e.g. pip install 'oysterbench[learn]'"
        assert result.stderr == f"oysterbench: train: No module named 'torch'; {advice}\n"
    assert "expected a click command, got <class 'int'>" in run("odd").stderr


def test_the_baselines_are_installed_in_both_groups():
    assert "unet" in train.list_commands(click.Context(train))
    assert "sim2real" in experiment.list_commands(click.Context(experiment))
    for group, name in ((train, "unet"), (experiment, "sim2real")):
        help_text = CliRunner().invoke(main, [group.name, name, "--help"]).stdout
        assert "Examples:" in help_text
