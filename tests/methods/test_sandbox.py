"""What runs in a sandbox: what it cannot open, whom it cannot reach, where it ends."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from oysterbench.methods import processes
from oysterbench.methods.processes import environment
from oysterbench.methods.sandbox import SINCE_OUTSIDE, Sandbox, can_hide, landlock_version

hides = pytest.mark.skipif(not can_hide(), reason="needs Landlock: Linux 5.13 or later")


def python(sandbox: Sandbox, code: str, *args: object) -> subprocess.CompletedProcess[str]:
    command = sandbox.command([sys.executable, "-c", code, *map(str, args)])
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    folder = tmp_path / "data" / "truth"
    folder.mkdir(parents=True)
    (folder / "secret.txt").write_text("1.2345")
    (tmp_path / "data" / "images.txt").write_text("may be read")
    (tmp_path / "link").symlink_to(folder / "secret.txt")
    return folder


READS = "import sys; print(open(sys.argv[1]).read())"


@hides
def test_a_hidden_folder_cannot_be_read_by_any_way_to_it(truth, tmp_path):
    sandbox = Sandbox(hidden=(str(truth),))
    ways = (truth / "secret.txt", tmp_path / "link", f"{tmp_path}/data/../data/truth/secret.txt")
    for path in (*ways, f"/proc/{os.getpid()}/root{truth}/secret.txt"):
        done = python(sandbox, READS, path)
        assert done.returncode == 1
        assert "PermissionError" in done.stderr
        assert "1.2345" not in done.stdout
    for code in ("os.listdir(sys.argv[1])", "os.rename(sys.argv[1] + '/secret.txt', '/tmp/x')"):
        assert "Permission denied" in python(sandbox, f"import os, sys; {code}", truth).stderr
    again = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[2], sys.argv[1]], check=True)"
    assert "PermissionError" in python(sandbox, again, truth / "secret.txt", READS).stderr, "nor by a child of it"
    assert (truth / "secret.txt").read_text() == "1.2345"


@hides
def test_what_lies_beside_a_hidden_folder_is_read_and_written_as_ever(truth, tmp_path):
    sandbox = Sandbox(hidden=(str(truth),))
    assert python(sandbox, READS, truth.parent / "images.txt").stdout == "may be read\n"
    (tmp_path / "out").mkdir()
    writes = "import os, sys; open(sys.argv[1], 'w').write('x'); os.rename(sys.argv[1], sys.argv[1] + '.new')"
    done = python(sandbox, writes, tmp_path / "out" / "file")
    assert (done.returncode, os.listdir(tmp_path / "out")) == (0, ["file.new"]), done.stderr


@hides
def test_a_visible_file_of_a_hidden_folder_is_read_and_not_written(truth):
    sandbox = Sandbox(hidden=(str(truth.parent),), visible=(str(truth / "secret.txt"),))
    assert python(sandbox, READS, truth / "secret.txt").stdout == "1.2345\n"
    assert "PermissionError" in python(sandbox, "import sys; open(sys.argv[1], 'a')", truth / "secret.txt").stderr
    assert "PermissionError" in python(sandbox, READS, truth.parent / "images.txt").stderr


@hides
def test_where_only_some_folders_are_writable_all_others_are_read(truth, tmp_path):
    sandbox = Sandbox(writable=(str(tmp_path),), fixed=(str(truth),))
    appends = "import sys; open(sys.argv[1], 'a')"
    assert python(sandbox, READS, truth / "secret.txt").stdout == "1.2345\n"
    assert python(sandbox, appends, truth.parent / "images.txt").returncode == 0
    for path in (truth / "secret.txt", truth / "new", __file__):
        assert "PermissionError" in python(sandbox, appends, path).stderr
    hides_all = Sandbox(hidden=(str(tmp_path),), writable=(str(truth),))
    assert python(hides_all, appends, truth / "secret.txt").returncode == 0
    assert "PermissionError" in python(hides_all, READS, truth.parent / "images.txt").stderr


@pytest.mark.skipif(landlock_version() < SINCE_OUTSIDE, reason="needs Linux 6.12 or later")
@pytest.mark.parametrize("network", [True, False])
def test_no_process_outside_is_signalled(network):
    signals = "import os, sys; os.kill(int(sys.argv[1]), 0); print('reached')"
    assert "PermissionError" in python(Sandbox(network=network), signals, os.getpid()).stderr
    assert python(Sandbox(network=network), "import os; os.kill(os.getpid(), 9)").returncode == -9


def test_the_environment_of_whoever_started_it_is_not_read_even_by_root(truth):
    reads = "import os; print(open(f'/proc/{os.getppid()}/environ').read())"
    assert "PermissionError" in python(Sandbox(hidden=(str(truth),)), reads).stderr


def test_without_a_network_no_server_is_reached():
    with socket.create_server(("127.0.0.1", 0)) as server:
        connect = "import socket, sys; socket.create_connection(('127.0.0.1', int(sys.argv[1])), 5)"
        port = server.getsockname()[1]
        assert python(Sandbox(), connect, port).returncode == 0
        assert "Error" in python(Sandbox(network=False), connect, port).stderr


@pytest.mark.parametrize(
    ("sandbox", "code", "message"),
    [
        (Sandbox(memory_bytes=500_000_000), "x = bytearray(1_000_000_000)", "MemoryError"),
        (Sandbox(open_files=20), "files = [open('/dev/null') for _ in range(30)]", "Too many open files"),
        (Sandbox(cpu_s=1), "while True: pass", ""),
    ],
    ids=["memory", "open files", "processor time"],
)
def test_it_ends_at_its_limits(sandbox, code, message):
    done = python(sandbox, code)
    assert done.returncode != 0
    assert message in done.stderr


def test_the_command_keeps_its_arguments_input_and_exit_status():
    done = subprocess.run(Sandbox().command(["sh", "-c", "cat; exit 7"]), input=b"in", capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (7, b"in")


def test_a_method_is_told_where_trained_weights_are_and_neither_where_data_is_nor_any_salt(monkeypatch, tmp_path):
    for name in ("OYSTERBENCH_MODELS", "OYSTERBENCH_UNET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path))
    monkeypatch.setenv("OYSTERBENCH_SALT", "secret")
    of_weights = {"OYSTERBENCH_STEERING": "best.pth", "OYSTERBENCH_UNET_SMALL": "weights", "OYSTERBENCH_MINE": "my.pt"}
    for name, value in of_weights.items():
        monkeypatch.setenv(name, value)
    told = {key: value for key, value in environment().items() if key.startswith("OYSTERBENCH_")}
    assert told == {"OYSTERBENCH_MODELS": str(tmp_path / "models"), **of_weights}
    monkeypatch.setenv("OYSTERBENCH_MODELS", str(tmp_path / "elsewhere"))
    assert environment()["OYSTERBENCH_MODELS"] == str(tmp_path / "elsewhere")
    monkeypatch.setattr(processes, "weights_names", lambda: ["salt", "token", "home", "theirs"])
    for name in ("TOKEN", "SALT_FILE", "THEIRS"):
        monkeypatch.setenv(f"OYSTERBENCH_{name}", "secret.pt" if name == "SALT_FILE" else "secret")
    named = {key for key in environment() if key.startswith("OYSTERBENCH_")}
    assert named == {"OYSTERBENCH_MODELS", "OYSTERBENCH_THEIRS", "OYSTERBENCH_MINE"}
