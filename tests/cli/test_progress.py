"""What is shown while runs go on."""

from __future__ import annotations

import re

import pytest

from oysterbench.cli import progress
from oysterbench.cli.progress import bytes_bar, late_bars, plain_runs, runs_shown
from oysterbench.methods import runner
from oysterbench.methods.run_output import RunOutput
from tests.helpers.command import run
from tests.helpers.programs import PROGRAMS, command

RUN = "mine on mini-01, run 1"


def test_off_a_terminal_each_run_tells_its_tenths_of_every_pass(capsys, monkeypatch):
    tell = plain_runs()
    for done in [*range(0, 101, 5), 0, 10]:
        tell({RUN: RunOutput(done, 100), "other": RunOutput(1, 3)})
    monkeypatch.setattr(progress, "QUIET_S", 0.0)
    tell({RUN: RunOutput(line="much else since then"), "other": RunOutput(1, 3)})
    lines = [re.sub(", [0-9]+ s left", "", line) for line in capsys.readouterr().err.splitlines()]
    assert lines.count("other: 1 of 3") == 1
    expected = [f"{RUN}: {done} of 100" for done in [*range(0, 101, 10), 0, 10]]
    assert [line for line in lines if line.startswith(RUN)] == expected


def test_work_of_several_stages_has_a_bar_for_each_that_takes_long(capsys, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with late_bars("map of mini-01") as tell:
        for stage, step_s in (("pictures", 1.0), ("pictures registered", 0.1), ("pictures counted", 1.0)):
            for done in range(11):
                now[0] += step_s
                tell(stage, done, 10)
    lines = [line.partition(",")[0] for line in capsys.readouterr().err.splitlines()]
    for stage in ("pictures", "pictures counted"):
        assert f"map of mini-01: 10 of 10 {stage}" in lines
    assert not [line for line in lines if "registered" in line]


def test_off_a_terminal_other_lines_are_told_now_and_then(capsys, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    tell = plain_runs()
    for second in range(70):
        now[0] = 1000.0 + second
        tell({RUN: RunOutput(line=f"at {second // 5}\x1b[31m")})
    assert capsys.readouterr().err.splitlines() == [f"{RUN}: at 6\\u001b[31m", f"{RUN}: at 12\\u001b[31m"]


def test_a_terminal_has_a_line_for_each_run_that_goes_on(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    with runs_shown() as tell:
        tell({RUN: RunOutput(55, 140, "loop closed"), "other on mini-01, run 2": RunOutput(line="[b]map[/b]")})
        first = capsys.readouterr()
        tell({RUN: RunOutput(line="much else since then"), "other on mini-01, run 2": RunOutput(line="[b]map[/b]")})
        tell({"other on mini-01, run 2": RunOutput(line="mapping")})
    last = capsys.readouterr()
    lines = [re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", line) for line in first.err.splitlines()]
    assert any(re.match(rf"{RUN} +\S+ 55 of 140 ", line) for line in lines)
    assert any("[b]map[/b]" in line for line in lines)
    assert max(map(len, lines)) <= 80
    assert "mapping" in last.err
    assert "much else" not in last.err
    assert not first.out + last.out


@pytest.mark.parametrize("option", ["--json", ""])
def test_what_a_program_says_is_shown_but_where_stdout_is_for_machines(option, dive_file, tmp_path, monkeypatch):
    monkeypatch.setitem(PROGRAMS, "says", "import time; print('progress 3 of 10', flush=True); time.sleep(2)")
    monkeypatch.setattr(runner, "LOOK_S", 0.1)
    template = command(tmp_path, "says", dive_file)
    words = ("run", "mine", "--command", template, "--on", dive_file, "--out", tmp_path / "out")
    done = run(*words, *([option] if option else []), home=tmp_path / "home")
    assert ("mine on hand-made, run 1: 3 of 10\n" in done.stderr) == (not option)


def test_few_bytes_are_told_in_kilobytes(capsys):
    with bytes_bar("sending") as tell:
        tell(2_000, 20_000)
    with bytes_bar("sending") as tell:
        tell(2_000_000, 20_000_000)
    assert capsys.readouterr().err == "sending: 2.0 of 20.0 kB\nsending: 2.0 of 20.0 MB\n"
