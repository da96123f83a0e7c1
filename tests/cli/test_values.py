"""Options whose value is missing: none takes the next option for it."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.cli.values import check_values


@pytest.mark.parametrize(
    ("words", "option", "taken"),
    [
        ("compare x --report --json", "--report", "--json"),
        ("compare x --report -h", "--report", "-h"),
        ("compare x --report --jsn", "--report", "--jsn"),
        ("compare x --report -- x", "--report", "--"),
        ("eval slam --truth a.tum --estimate b.tum --out --csv", "--out", "--csv"),
        ("eval --truth a.tum --estimate b.tum --out --json --track slam", "--out", "--json"),
        ("eval --out here --track slam --truth --json", "--truth", "--json"),
        ("run mine --split slam-mini --max-gap --json", "--max-gap", "--json"),
        ("export mini-01.mcap --format tum --out --no-truth", "--out", "--no-truth"),
        ("leaderboard --split --json", "--split", "--json"),
        ("leaderboard serve --board --help", "--board", "--help"),
        ("leaderboard --board b add r --team --tier reported", "--team", "--tier"),
        ("leaderboard --board b --json team add --token-file --another reef", "--token-file", "--another"),
        ("submit r --to http://localhost --method m --url --no-wait", "--url", "--no-wait"),
    ],
)
def test_an_option_without_its_value_does_not_take_the_next_one_for_it(words, option, taken, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, words.split())
    assert result.exit_code == 2
    assert f"{option}: expected a value, got {taken}; if it is the value: {option}={taken}\n" in result.stderr
    assert not list(tmp_path.iterdir())


@pytest.fixture
def group():
    """A group with an option, and a command with options of every kind."""

    @click.group()
    @click.option("--name")
    def group(name):
        pass

    @group.command()
    @click.argument("words", nargs=-1)
    @click.option("--offset", type=float)
    @click.option("--out")
    @click.option("-v", "verbose", count=True)
    @click.option("--truth/--no-truth")
    def command(**values):
        pass

    return group


@pytest.mark.parametrize(
    "words",
    [
        "--name command command --offset -0.5",
        "command --out - --no-truth",
        "command --out=--no-truth --offset=-1",
        "command --truth --no-truth -v --out -x",
        "command --no-truth -- --out --truth",
        "command --out",
        "unknown --out --truth",
    ],
)
def test_values_that_begin_with_one_dash_or_follow_an_equals_sign_are_taken(group, words):
    check_values(click.Context(group), group, words.split())


@pytest.mark.parametrize("words", ["--name --help command", "--name command command --out -v", "command --out --truth"])
def test_options_of_every_level_are_checked(group, words):
    with pytest.raises(click.UsageError, match="expected a value"):
        check_values(click.Context(group), group, words.split())
