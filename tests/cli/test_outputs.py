"""Tables on stdout: as wide as it is, with nothing at the ends of lines, and readable in 80 columns."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main

COMMANDS = (
    ("splits",),
    ("doctor",),
    ("models",),
    ("systems",),
    ("leaderboard", "--split", "slam-val"),
    ("splits", "slam-val"),
)


@pytest.fixture(autouse=True)
def _own_home(home):
    """Nothing is there but what comes with the program."""


def lines(*words, **environment):
    done = CliRunner().invoke(main, words, env={"COLUMNS": None, **environment})
    assert done.exit_code == 0, done.output
    return done.stdout.splitlines()


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_a_pipe_heeds_the_columns_that_are_said_and_gets_no_blanks_at_the_ends_of_lines(words):
    narrow, wide = lines(*words, COLUMNS="80"), lines(*words)
    assert max(map(len, narrow)) <= 80
    assert len(wide) <= len(narrow)
    assert all(line == line.rstrip() for line in [*narrow, *wide])


def test_splits_can_be_read_in_80_columns_and_say_what_was_left_out():
    found = lines("splits", COLUMNS="80")
    (row,) = [line for line in found if line.startswith(" slam-mini 1.0")]
    assert "20 s over a patchy reef" in row
    assert found[-1] == "Left out at this width: track, sequences, seconds."
    assert len(found) < 3 * len(lines("splits")), "two or three lines a split, and not eight"


def test_a_board_keeps_rank_score_and_record_whole_in_80_columns():
    found = lines("leaderboard", "--split", "slam-val", COLUMNS="80")
    wide = lines("leaderboard", "--split", "slam-val")
    (whole,) = [line.split() for line in wide if " dead_reckoning " in line]
    (row,) = [line.split() for line in found if " dead_reckoning " in line]
    assert (row[0], row[2], row[-1]) == (whole[0], whole[3], whole[-1])
    assert any(line.startswith("Left out at this width: team, ") for line in found)


def test_a_board_keeps_ranks_names_and_scores_whole_in_40_columns():
    found = lines("leaderboard", "--split", "slam-val", "--rows", "3", COLUMNS="40")
    wide = [line.split() for line in lines("leaderboard", "--split", "slam-val", "--rows", "3")]
    row = next(line.split() for line in found if " dead_reckoning " in line)
    whole = next(words for words in wide if "dead_reckoning" in words)
    assert row == [whole[0], whole[1], whole[3]]
    assert max(map(len, found)) <= 40
    assert "Left out at this width: team, 95% interval, cover %, " in " ".join(found)


def test_every_file_that_is_named_gets_the_folders_that_are_not_there(trajectories, tmp_path):
    truth, estimate = map(str, trajectories)
    files = {form: tmp_path / form / "new" / f"r.{form}" for form in ("csv", "tex", "md")}
    words = [word for form, path in files.items() for word in (f"--{form}", str(path))]
    report, key = tmp_path / "report" / "new" / "r.html", tmp_path / "key" / "new" / "k.pem"
    lines("eval", "slam", "--truth", truth, "--estimate", estimate, *words, "--report", str(report))
    lines("keygen", str(key))
    assert all(path.is_file() for path in (*files.values(), report, key))


def test_a_page_on_stdout_is_refused_and_no_file_is_named_like_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["compare", "a", "b", "--report", "-"])
    assert done.exit_code == 2
    assert "--report: expected a file for the HTML page" in done.output
    assert list(tmp_path.iterdir()) == []
