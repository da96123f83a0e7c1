"""The limited process: what it may not do, and what becomes of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from oysterbench_leaderboard.submissions import limited
from oysterbench_leaderboard.submissions.limited import Allowance, Stopped

ALLOWED = Allowance(wall_s=30.0, cpu_s=10, memory_bytes=1_000_000_000, file_bytes=1_000_000)

PRELUDE = """
import importlib.util, json, os, resource, sys
spec = importlib.util.spec_from_file_location("child", {child!r})
child = importlib.util.module_from_spec(spec)
spec.loader.exec_module(child)
def do(job):
{body}
child.do = do
child.main()
"""


@pytest.fixture
def doing(tmp_path, monkeypatch):
    """A limited process that does what it is told to."""
    real = str(limited.CHILD)

    def make(body: str) -> None:
        script = tmp_path / "evil.py"
        indented = "\n".join(f"    {line}" for line in body.splitlines())
        script.write_text(PRELUDE.format(child=real, body=indented))
        monkeypatch.setattr(limited, "CHILD", script)

    return make


def test_it_answers_on_a_pipe_that_nothing_else_writes_to(doing):
    doing("print('noise'); os.write(1, b'more noise'); return {'twice': 2 * job['n']}")
    ended = limited.run({"n": 21}, ALLOWED)
    assert ended.answer == {"twice": 42}
    assert "noise" in ended.said


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("x = bytearray(2_000_000_000)", "MemoryError"),
        ("open('big', 'wb').write(bytes(3_000_000))", ""),
        ("files = [open('/dev/null') for _ in range(200)]", "Too many open files"),
        ("import socket; socket.create_connection(('127.0.0.1', int(job['port'])), 5)", "Error"),
        ("os.abort()", ""),
        ("raise ValueError('the truth is 1.2345')", "the truth is 1.2345"),
        ("return 'x' * 80_000_000", ""),
    ],
    ids=["memory", "file size", "open files", "network", "abort", "error", "endless answer"],
)
def test_what_it_may_not_do_ends_it_without_an_answer(doing, body, said):
    import socket

    doing(body)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        ended = limited.run({"port": listening.getsockname()[1]}, ALLOWED)
    assert ended.answer is None
    assert ended.cause == ("memory" if "Memory" in said else "crash")
    assert said in ended.said


def test_it_knows_nothing_of_the_servers_environment_and_folder(doing, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_SALT", "a secret that must not be known")
    doing("return {'env': dict(os.environ), 'here': os.listdir('.'), 'session': os.getsid(0), 'pid': os.getpid()}")
    answer = limited.run({}, ALLOWED).answer
    assert "a secret" not in str(answer)
    assert answer["here"] == []
    assert answer["session"] == answer["pid"]
    assert not os.path.exists(answer["env"]["HOME"]), "its folder went with it"


@pytest.mark.parametrize(
    ("body", "allowance"),
    [
        ("import time; time.sleep(60)", Allowance(0.5, 10, ALLOWED.memory_bytes, 1000)),
        ("while True: pass", Allowance(30.0, 1, ALLOWED.memory_bytes, 1000)),
    ],
    ids=["sleeps", "computes"],
)
def test_its_time_ends(doing, body, allowance):
    doing(body)
    begun = time.monotonic()
    ended = limited.run({}, allowance)
    assert (ended.answer, ended.cause) == (None, "time")
    assert time.monotonic() - begun < 29


def test_it_is_stopped_when_the_server_stops_or_loses_its_lease(doing):
    doing("import time; time.sleep(60)")
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    with pytest.raises(Stopped):
        limited.run({}, ALLOWED, stop)
    with pytest.raises(Stopped):
        limited.run({}, ALLOWED, beat=lambda: False, beat_s=0.1)


RUNS = """
import sys
from pathlib import Path
from oysterbench_leaderboard.submissions import limited
limited.CHILD = Path(sys.argv[1])
limited.run({"tell": sys.argv[2]}, limited.Allowance(60.0, 60, 1_000_000_000, 1_000_000))
"""


def test_it_dies_with_the_server(doing, tmp_path):
    doing("import time; open(job['tell'], 'w').write(str(os.getpid())); time.sleep(60)")
    told = tmp_path / "pid"
    server = subprocess.Popen([sys.executable, "-c", RUNS, str(limited.CHILD), str(told)])
    end = time.monotonic() + 30
    while not (told.exists() and told.read_text()):
        assert time.monotonic() < end
        time.sleep(0.02)
    pid = int(told.read_text())
    os.kill(pid, 0)
    server.send_signal(signal.SIGKILL)
    server.wait()
    while True:
        try:
            with open(f"/proc/{pid}/stat") as file:
                if file.read().rpartition(")")[2].split()[0] == "Z":  # dead, and nobody has waited for it
                    break
        except (FileNotFoundError, ProcessLookupError):
            break
        assert time.monotonic() < end
        time.sleep(0.02)
