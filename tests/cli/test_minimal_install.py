"""After `make demo`, which installs the extras render and slam alone, every command works or says what to install."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from oysterbench.core.trajectory import write_tum
from oysterbench.sequence import open_sequence
from tests.helpers.extras import only

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
    (("leaderboard", "build", "site"), "oysterbench[board]"),
    (("leaderboard", "serve"), "oysterbench[board]"),
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
def answers(dive_file, tmp_path_factory):
    """Command -> exit status, stderr and exception, of all of them, in one process."""
    folder = tmp_path_factory.mktemp("demo")
    (folder / "dive.mcap").symlink_to(dive_file)
    write_tum(folder / "mine.tum", open_sequence(dive_file).truth())
    (folder / "tree").mkdir()
    (folder / "tree" / "index.json").write_text("{}")
    (folder / "masks").mkdir()
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
