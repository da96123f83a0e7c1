"""What the system could not do is one line, with the file that its user knows and what to do next."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from oysterbench.cli.failures import told
from oysterbench.cli.main import main
from oysterbench.core import atomic, disk_space


@pytest.mark.parametrize(
    ("number", "next_step"),
    [
        (errno.ENOSPC, "; make room there or choose another place, and run the same command again"),
        (errno.EDQUOT, "; make room there or choose another place, and run the same command again"),
        (errno.EROFS, "; choose another place that you may write to"),
        (errno.EACCES, "; choose another place that you may write to"),
        (errno.EISDIR, ""),
    ],
)
def test_a_disk_that_takes_nothing_comes_with_a_next_step(number, next_step):
    why = os.strerror(number)
    assert told(OSError(number, why, "/mnt/out/a")) == f"/mnt/out/a: {why}{next_step}"
    assert told(OSError(number, why)) == why + (next_step if "room" in next_step else "")


def test_under_the_home_folder_it_is_the_variable_that_names_another(tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path))
    full = OSError(errno.ENOSPC, "full", str(tmp_path / "splits" / "x"))
    assert told(full).endswith("choose another home folder (OYSTERBENCH_HOME), and run the same command again")


def test_a_file_that_may_not_be_read_is_not_one_to_write_elsewhere(tmp_path, monkeypatch):
    file = tmp_path / "a.tum"
    file.touch()
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # whoever runs this may be one who may read everything
    assert (
        told(PermissionError(errno.EACCES, "no", str(file))) == f"{file}: no; `chmod u+r {file}` lets its owner read it"
    )


def test_the_file_of_another_user_such_as_a_lock_is_not_made_readable_for_that_user(tmp_path, monkeypatch):
    file = tmp_path / ".publishing.lock"
    file.touch()
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setattr(os, "geteuid", lambda: file.stat().st_uid + 1)
    error = PermissionError(errno.EACCES, "no", str(file))
    assert told(error) == f"{file}: no; it belongs to another user: run the same command as that user"


def export(file, out, form):
    return CliRunner().invoke(main, ["export", str(file), "--format", form, "--out", str(out)])


def test_a_disk_that_fills_up_in_an_export_is_named_by_its_folder_and_nothing_is_left(dive_file, tmp_path, monkeypatch):
    write = Path.write_text

    def full(path, *args, **kwargs):
        if ".draft" in str(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write(path, *args, **kwargs)

    monkeypatch.setattr(Path, "write_text", full)
    done = export(dive_file, tmp_path / "out", "foxglove")
    assert done.exit_code == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"oysterbench: {tmp_path / 'out'}: No space left on device; make room there or choose")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("form", ["mcap", "yolo"])
def test_an_export_for_which_there_is_no_room_ends_at_once(dive_file, tmp_path, monkeypatch, form):
    monkeypatch.setattr(disk_space, "free_bytes", lambda folder: 10)
    monkeypatch.setattr(disk_space, "FIRST", 1)
    done = export(dive_file, tmp_path / "out", form)
    assert done.exit_code == 1
    assert f"oysterbench: {tmp_path / 'out'}: not enough room: this needs some" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_to_is_named_and_not_what_was_to_be_in_it(tmp_path, monkeypatch):
    def forbidden(dir, prefix):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), f"{dir}/{prefix}x7yq")

    monkeypatch.setattr(atomic.tempfile, "mkstemp", forbidden)
    done = CliRunner().invoke(main, ["oyster", "--out", str(tmp_path / "o.glb")])
    assert done.stderr == (
        f"oysterbench: {tmp_path / 'o.glb'}: Read-only file system; choose another place that you may write to\n"
    )


@pytest.mark.parametrize("what", ["file", "link to something that is not there"])
def test_a_home_that_is_no_folder_is_named_with_the_variable_that_names_it(what, tmp_path, monkeypatch):
    place = tmp_path / "home"
    place.touch() if what == "file" else place.symlink_to(tmp_path / "absent")
    monkeypatch.setenv("OYSTERBENCH_HOME", str(place))
    done = CliRunner().invoke(main, ["render", "slam-mini"])
    assert done.exit_code == 1
    assert done.stderr.endswith(f"; {place} is a {what}: let OYSTERBENCH_HOME name a folder\n"), done.stderr
    done = CliRunner().invoke(main, ["doctor"])
    assert f"broken: home: {place} is a {what}\n" in done.stderr


@pytest.mark.parametrize(
    "words",
    [("info", "nosuch"), ("view", "nosuch"), ("render", "nosuch"), ("splits", "nosuch"), ("download", "moving")],
    ids=" ".join,
)
def test_a_refusal_loads_nothing_that_only_the_work_needs(words, tmp_path):
    """So it is told in a few tenths of a second."""
    code = "\n".join(
        [
            "import sys",
            "from oysterbench.cli.main import main",
            "try:",
            f"    main({list(words)})",
            "except SystemExit as end:",
            "    assert end.code == 1, end.code",
            "print(*{'cv2', 'scipy', 'pandas', 'matplotlib', 'torch', 'warp', 'rich'} & set(sys.modules))",
        ]
    )
    environment = {**os.environ, "OYSTERBENCH_HOME": str(tmp_path), "OYSTERBENCH_HUB": ""}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    assert done.stderr.startswith("oysterbench: "), done.stderr
    assert done.stdout == "\n"
