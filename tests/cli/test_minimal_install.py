"""After `make demo`, which installs the extras render and slam alone, every command works or says what to install."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from oysterbench.core.trajectory import write_tum
from oysterbench.results.records import write_results
from oysterbench.sequence import open_sequence
from tests.helpers.extras import only
from tests.helpers.records_made import record_made

WORKS = (
    ("doctor",),
    ("splits",),
    ("splits", "slam-val"),
    ("models",),
    ("systems",),
    ("info", "dive.mcap"),
    ("eval", "slam", "--truth", "dive.mcap", "--estimate", "mine.tum", "--report", "report.html"),
    ("export", "dive.mcap", "--format", "euroc", "--out", "euroc"),
    ("map", "dive.mcap", "--trajectory", "mine.tum", "--masks", "truth", "--depth", "layer", "--out", "map"),
    ("view", "dive.mcap", "--out", "dive.html"),
    ("keygen", "key.pem"),
    ("verify",),
    ("oyster", "--out", "oyster.glb"),
    ("leaderboard",),
    ("leaderboard", "literature"),
    ("compare", "gtsam_vi", "gtsam_full", "--split", "slam-mini"),
)
LACK = (
    (("serve", "tree"), "oysterbench[serve]"),
    (("train", "unet_small", "--data", "masks"), "oysterbench[learn]"),
    (("eval", "detection", "--split", "seg-mini", "--method", "colour"), "oysterbench[score]"),
    (("run", "colour", "--track", "detection", "--on", "pictures", "--out", "check"), "oysterbench[score]"),
    (("leaderboard", "build", "site"), "oysterbench[board]"),
    (("leaderboard", "serve"), "oysterbench[board]"),
    (("leaderboard", "--board", "board", "add", "results.json", "--team", "mine"), "oysterbench[board]"),
    (("leaderboard", "withdraw", "3f9c21ab", "--reason", "A mistake."), "oysterbench[board]"),
)
CALLS = """
import json, sys
from click.testing import CliRunner
from oysterbench.cli.main import main
for words in json.load(sys.stdin):
    done = CliRunner().invoke(main, words)
    print(json.dumps([done.exit_code, done.stderr, done.exception is not None and repr(done.exception)]))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The working folder of the commands."""
    return tmp_path_factory.mktemp("demo")


@pytest.fixture(scope="module")
def answers(dive_file, folder):
    """Command -> exit status, stderr and exception, of all of them, in one process."""
    (folder / "dive.mcap").symlink_to(dive_file)
    write_tum(folder / "mine.tum", open_sequence(dive_file).truth())
    (folder / "tree").mkdir()
    (folder / "tree" / "index.json").write_text("{}")
    (folder / "masks").mkdir()
    write_results(folder / "results.json", record_made().results)
    every = [*WORKS, *(words for words, _ in LACK)]
    done = subprocess.run(
        [sys.executable, "-c", CALLS],
        input=json.dumps(every),
        env=only(["render", "slam"], folder / "start") | {"OYSTERBENCH_HOME": str(folder / "home")},
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(zip(every, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("words", WORKS, ids=" ".join)
def test_a_command_works(words, answers):
    code, told, raised = answers[words]
    assert code == 0, (told, raised)


@pytest.mark.parametrize(
    ("words", "extra"), LACK, ids=lambda value: " ".join(value) if isinstance(value, tuple) else ""
)
def test_a_command_says_what_to_install(words, extra, answers):
    code, told, raised = answers[words]
    assert code == 1, raised
    assert f"pip install '{extra}'" in told
    assert told.count("\n") == 1


def test_a_command_that_lacks_an_extra_leaves_the_board_as_it_was(answers, folder):
    assert not (folder / "board").exists()


def test_no_method_is_run_whose_oysters_could_not_be_matched(answers, folder):
    """They would be missed after all runs, and a result of the method would say that it failed."""
    assert not (folder / "check").exists()
