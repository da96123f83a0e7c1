"""Commands for the operators of a server that takes submissions."""

from __future__ import annotations

import json
import re
from typing import get_args

import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench_leaderboard.submissions.command_admin import STATES
from oysterbench_leaderboard.submissions.database import State


def test_operators_make_teams_read_the_log_and_try_again(tmp_path):
    def run(*args):
        return CliRunner().invoke(main, ["leaderboard", *args, "--submissions", str(tmp_path / "private")])

    made = run("team", "add", "reef lab")
    assert made.exit_code == 0, made.output
    token = made.stdout.strip()
    assert re.fullmatch(r"oyb_[0-9a-f]{12}_[\w-]{43}", token)
    twice = run("team", "add", "reef lab")
    assert (twice.exit_code, twice.stdout, twice.stderr.count("\n")) == (1, "", 1)
    assert "add --replace to revoke it and print a new one, or --another for one more" in twice.stderr
    file = tmp_path / "token"
    assert run("team", "add", "reef lab", "--another", "--token-file", str(file)).stdout == f"{file}\n"
    assert (file.stat().st_mode & 0o777, file.read_text()[:4]) == (0o600, "oyb_")
    assert "left unchanged" in run("team", "add", "reef lab", "--another", "--token-file", str(file)).stderr
    assert "reef lab" in run("team", "list").stdout
    assert token not in run("team", "list").stdout
    rows = json.loads(run("team", "list", "--json").stdout)
    assert {row["id"] for row in rows} == {token.split("_")[1], file.read_text().split("_")[1]}
    assert run("team", "revoke", token.split("_")[1]).stdout.startswith("revoked: ")
    assert "token revoked" in run("submissions", "log").stdout
    assert run("submissions", "list").stdout == ""
    failed = run("submissions", "retry", "0" * 16)
    assert (failed.exit_code, "no submission of that id has failed" in failed.stderr) == (1, True)


@pytest.mark.parametrize(
    ("args", "status", "said"),
    [
        (("list", "--state", "runing"), 2, "'runing' is not one of 'queued', 'running', 'done', 'failed', 'withdrawn'"),
        (("log", "zzzz"), 1, "zzzz: no submission has that id; `submissions list` lists them"),
    ],
)
def test_a_state_or_a_submission_that_there_is_not_is_named(tmp_path, args, status, said):
    private = ("--submissions", str(tmp_path / "private"))
    assert CliRunner().invoke(main, ["leaderboard", "team", "add", "reef lab", *private]).exit_code == 0
    asked = CliRunner().invoke(main, ["leaderboard", "submissions", *args, *private])
    assert (asked.exit_code, asked.stdout) == (status, "")
    assert said in asked.stderr


@pytest.mark.parametrize(
    "args",
    [("submissions", "list"), ("submissions", "log"), ("submissions", "backup", "all.tar"), ("team", "list")],
    ids=lambda args: args[1],
)
def test_a_folder_that_is_no_server_is_left_alone(tmp_path, monkeypatch, args):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "other"
    folder.mkdir(mode=0o755)
    before = folder.stat()
    asked = CliRunner().invoke(main, ["leaderboard", *args, "--submissions", str(folder)])
    assert (asked.exit_code, asked.stdout, asked.stderr.count("\n")) == (1, "", 1)
    assert "expected the private folder of a server, got one without submissions.sqlite" in asked.stderr
    assert (list(folder.iterdir()), list(tmp_path.iterdir())) == ([], [folder])
    assert folder.stat().st_mode == before.st_mode


@pytest.mark.parametrize("name", ["key", "settings.toml"])
def test_a_folder_without_a_database_is_backed_up_by_nobody(tmp_path, name):
    """It would be made, and the backup of it would hold nothing."""
    (tmp_path / "k").mkdir()
    (tmp_path / "k" / name).write_text("lines = 10\n")
    words = ["leaderboard", "submissions", "backup", str(tmp_path / "k.tar"), "--submissions", str(tmp_path / "k")]
    asked = CliRunner().invoke(main, words)
    assert (asked.exit_code, "expected the private folder of a server" in asked.stderr) == (1, True)
    assert [path.name for path in tmp_path.rglob("*")] == ["k", name]


def test_a_team_is_added_to_no_folder_of_somebody_else(tmp_path):
    www, new = tmp_path / "www", tmp_path / "new"
    (www / "html").mkdir(parents=True)
    www.chmod(0o755)
    add = ["leaderboard", "team", "add", "reef lab", "--submissions"]
    asked = CliRunner().invoke(main, [*add, str(www)])
    expected = f"{www}: expected a new or empty folder, or that of a server, got one with html; it was left unchanged"
    assert (asked.exit_code, asked.stdout, expected in asked.stderr) == (1, "", True)
    assert (www.stat().st_mode & 0o777, [path.name for path in www.iterdir()]) == (0o755, ["html"])
    new.mkdir()
    (new / "settings.toml").write_text("per_day = 3\n")  # as it is written before the first start
    assert CliRunner().invoke(main, [*add, str(new)]).exit_code == 0


def test_the_states_that_can_be_asked_for_are_those_of_the_database():
    assert get_args(State) == STATES
