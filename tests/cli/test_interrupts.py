"""What is said to who interrupts a command is so: what is kept, and what to type."""

from __future__ import annotations

import signal
import subprocess
import sys

import click
import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from oysterbench.cli import main as module
from oysterbench.cli.interrupts import BEGUN_ANEW, RESUMED, TOLD, interruption
from oysterbench.cli.main import main
from tests.helpers.waiting import until


def test_only_commands_that_there_are_have_a_sentence():
    assert {*RESUMED, *BEGUN_ANEW} <= set(main.list_commands(click.Context(main, **main.context_settings)))
    assert not RESUMED.keys() & BEGUN_ANEW.keys()


@pytest.mark.parametrize("name", sorted(RESUMED))
def test_a_command_that_goes_on_says_so_where_it_is_interrupted(name):
    """In its help, which is where a user learns of it beforehand."""
    command = main.get_command(click.Context(main, **main.context_settings), name)
    text = command.help if not isinstance(command, click.Group) else _help_of_first(command)
    assert any(word in text for word in ("goes on", "resume", "is kept", "finished")), text


def _help_of_first(group: click.Group) -> str:
    context = click.Context(group)
    found = [group.get_command(context, name) for name in group.list_commands(context)]
    return " ".join([group.help or "", *(one.help or "" for one in found if one is not None)])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["info", "x.mcap"], "interrupted; nothing was written"),
        (["splits"], "interrupted; nothing was written"),
        (["render", "slam-mini"], "interrupted; finished frames are kept, and the same command resumes from there: "),
        (["eval", "slam"], "interrupted; finished frames are kept, and results of finished runs are in results.json"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_an_interruption_is_one_line_and_130(words, said, home, monkeypatch):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(click.Command, "invoke", interrupt)
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 130
    assert done.stderr.startswith(f"oysterbench: {said}")
    assert done.stderr.count("\n") == 1


SLOW_EXPORT = """
import time
import oysterbench.sequence.export as export
from oysterbench.__main__ import main
export.SpaceCheck = lambda *folders: time.sleep(60)
main()
"""


def test_sigterm_clears_up_as_ctrl_c_does(dive_file, tmp_path):
    """An export fills a draft of its folder, which is gone when a scheduler ends it."""
    out = tmp_path / "out"
    words = ["export", dive_file, "--format", "euroc", "--out", out / "dive"]
    process = subprocess.Popen([sys.executable, "-c", SLOW_EXPORT, *map(str, words)], stderr=subprocess.PIPE, text=True)
    until((out / ".dive.draft").exists, process)
    process.send_signal(signal.SIGTERM)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 143
    assert stderr.splitlines()[-1] == "oysterbench: terminated; nothing was written"
    assert list(out.iterdir()) == []


def test_what_is_typed_again_is_what_was_typed(monkeypatch):
    monkeypatch.setattr("sys.argv", ["/usr/bin/oysterbench", "run", "my slam", "--split", "slam-mini"])
    assert interruption("run").endswith(": oysterbench run 'my slam' --split slam-mini")
    assert module.interruption is interruption


@pytest.mark.parametrize(
    "words",
    [
        ["train", "unet", "--data", "seg-train"],
        ["segment", "dive.mp4"],
        ["release", "slam-val"],
        ["run", "mine", "--track", "steering", "--closed-loop"],
    ],
)
def test_what_again_starts_over_resumes_without_it(words, monkeypatch):
    monkeypatch.setattr("sys.argv", ["oysterbench", *words, "--again"])
    said = f"the command without --again resumes from there: oysterbench {' '.join(words)}"
    assert interruption(words[0]).endswith(said)
    monkeypatch.setattr("sys.argv", ["oysterbench", "run", "--again"])
    assert interruption("run").endswith("the same command resumes from there: oysterbench run --again")
    monkeypatch.setattr("sys.argv", ["oysterbench", *words, "--again"])
    if words[0] in TOLD:
        assert interruption(words[0], begun=False) == (
            "interrupted before anything was started over; the same command begins: "
            f"oysterbench {' '.join(words)} --again"
        )


def test_what_again_starts_over_is_told_only_once_it_has_begun(tmp_path, home, monkeypatch):
    """Before that, the command without it would return what was there."""
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((40, 40, 3), np.uint8))
    words = ["segment", str(tmp_path / "a.png"), "--method", "colour", "--out", str(tmp_path / "out"), "--again"]
    monkeypatch.setattr("sys.argv", ["oysterbench", *words])

    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    for place, said in (
        ("oysterbench.counting.run.Counting.run", "the command without --again resumes from there: "),
        ("oysterbench.report.counting.check_folder", "before anything was started over; the same command begins: "),
    ):
        monkeypatch.setattr(place, interrupt)
        assert said in CliRunner().invoke(main, words).stderr


def test_records_that_were_scored_again_are_said_to_be_kept(monkeypatch):
    monkeypatch.setattr("sys.argv", ["oysterbench", "leaderboard", "rescore", "--estimates", "e"])
    assert interruption("leaderboard") == "interrupted; the records that were scored again are kept"
    for words in (["rescore", "--dry-run"], ["verify"]):
        monkeypatch.setattr("sys.argv", ["oysterbench", "leaderboard", *words])
        assert interruption("leaderboard") == "interrupted; nothing was written"


def test_an_evaluation_in_closed_loop_goes_on_with_its_rollouts_and_others_begin_anew(monkeypatch):
    monkeypatch.setattr("sys.argv", ["oysterbench", "eval", "steering", "--closed-loop"])
    assert interruption("eval") == (
        "interrupted; finished rollouts are kept, and the same command resumes from there: "
        "oysterbench eval steering --closed-loop"
    )
    monkeypatch.setattr("sys.argv", ["oysterbench", "eval", "steering"])
    assert "starts again from the first run" in interruption("eval")
