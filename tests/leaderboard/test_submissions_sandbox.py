"""The sandbox of submissions: what runs in it may not do, and what becomes of it."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import textwrap
from typing import Any

import pytest

from oysterbench.methods.sandbox import can_hide
from oysterbench_leaderboard.submissions.catalogue import Wanted
from oysterbench_leaderboard.submissions.reading.archive import Limits
from oysterbench_leaderboard.submissions.sandbox import namespaces, sandbox
from oysterbench_leaderboard.submissions.sandbox.sandbox import Allowance, Job, Stopped
from tests.helpers.paths import ROOT

ALLOWED = Allowance(wall_s=30.0, cpu_s=10, memory_bytes=1_000_000_000, file_bytes=1_000_000)
LIMITS = Limits(1, 1, 1, 1, 1.0)
WANTED = Wanted("slam", "pool-test", "", True, ("pool-01",))

PRELUDE = """
import importlib.util, json, os, resource, sys, time
spec = importlib.util.spec_from_file_location("worker", {worker!r})
worker = importlib.util.module_from_spec(spec)
spec.loader.exec_module(worker)
def do(job):
{body}
worker.do = do
worker.serve(worker.main) if sys.argv[1:] else worker.main()
"""
FOREVER = "while True: time.sleep(1)"


@pytest.fixture(params=[pytest.param("namespaces", marks=pytest.mark.slow), "Landlock", "forked"])
def doing(request, tmp_path, monkeypatch):
    """A sandbox that does what it is told to: `sandbox.run`."""
    real, run = str(sandbox.WORKER), sandbox.run
    if request.param == "Landlock":
        monkeypatch.setattr(namespaces, "missing", lambda: "not asked for")
    elif why := namespaces.missing():
        pytest.skip(f"no namespaces: {why}")
    with contextlib.ExitStack() as stack:

        def make(body: str) -> None:
            script = tmp_path / "evil.py"
            script.write_text(PRELUDE.format(worker=real, body=textwrap.indent(body, "    ")))
            monkeypatch.setattr(sandbox, "WORKER", script)
            if request.param == "forked":
                forks = stack.enter_context(contextlib.closing(sandbox.fork_server()))
                monkeypatch.setattr(sandbox, "run", lambda job, allowed: run(job, allowed, sandbox.never, forks))

        yield make


STARTED = pytest.mark.parametrize("doing", ["namespaces", "Landlock"], indirect=True)
"""Of what is asked of those alone that have a process of their own from the start, as scoring has."""


def job(path: object = __file__, **more: Any) -> Job:
    return Job(str(path), WANTED, LIMITS, **more)


def test_it_answers_on_a_pipe_that_nothing_else_writes_to(doing):
    doing("print('noise'); os.write(1, b'more noise'); return {'twice': 2 * int(job.method)}")
    ended = sandbox.run(job(method="21"), ALLOWED)
    assert ended.answer == {"twice": 42}
    assert "noise" in ended.stderr


@pytest.mark.parametrize(
    ("body", "stderr"),
    [
        ("x = bytearray(2_000_000_000)", "MemoryError"),
        ("open('big', 'wb').write(bytes(3_000_000))", ""),
        ("files = [open('/dev/null') for _ in range(200)]", "Too many open files"),
        ("import socket; socket.create_connection(('127.0.0.1', int(job.method)), 5)", "Error"),
        ("os.abort()", ""),
        ("raise ValueError('the truth is 1.2345')", "the truth is 1.2345"),
        ("return 'x' * 80_000_000", ""),
    ],
    ids=["memory", "file size", "open files", "network", "abort", "error", "endless answer"],
)
def test_what_it_may_not_do_ends_it_without_an_answer(doing, body, stderr):
    import socket

    doing(body)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        ended = sandbox.run(job(method=str(listening.getsockname()[1])), ALLOWED)
    assert ended.answer is None
    assert ended.cause == ("memory" if "Memory" in stderr else "crash")
    assert stderr in ended.stderr


def test_it_knows_nothing_of_the_servers_environment_and_folder(doing, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_SALT", "a secret that must not be known")
    doing("return {'env': dict(os.environ), 'here': os.listdir('.'), 'session': os.getsid(0), 'pid': os.getpid()}")
    answer = sandbox.run(job(), ALLOWED).answer
    assert "a secret" not in str(answer)
    assert answer["here"] == []
    assert answer["session"] in (answer["pid"], 1), "its own, or of the namespace that it is in"
    assert not os.path.exists(answer["env"]["HOME"]), "its folder went with it"


def test_it_leaves_no_compiled_code_which_a_limit_of_file_sizes_would_cut_for_everybody(doing):
    doing("return {'left': not sys.dont_write_bytecode}")
    assert sandbox.run(job(), ALLOWED).answer == {"left": False}


@pytest.mark.parametrize(
    ("body", "allowance"),
    [
        (FOREVER, Allowance(0.5, 10, ALLOWED.memory_bytes, 1000)),
        ("while True: pass", Allowance(30.0, 1, ALLOWED.memory_bytes, 1000)),
    ],
    ids=["sleeps", "computes"],
)
def test_its_time_ends(doing, body, allowance):
    doing(body)
    ended = sandbox.run(job(), allowance)
    assert (ended.answer, ended.cause) == (None, "time")


@STARTED
def test_it_is_stopped_when_nobody_wants_it_any_more(doing):
    doing(FOREVER)
    asked = iter([False, False, True])
    with pytest.raises(Stopped):
        sandbox.run(job(), ALLOWED, lambda: next(asked))


@STARTED
@pytest.mark.skipif(not can_hide(), reason="needs Landlock: Linux 5.13 or later")
def test_it_cannot_open_what_the_server_hides_but_the_files_of_its_job(doing, tmp_path):
    private = tmp_path / "private"
    private.mkdir()
    for name in ("upload", "truth", "submissions.sqlite"):
        (private / name).write_text(name)
    doing("return {name: open(os.path.join(os.path.dirname(job.path), name)).read() for name in job.method.split()}")
    hidden, truth = (str(private),), {"pool-01": str(private / "truth")}
    both = job(private / "upload", hidden=hidden, truth=truth, method="upload truth")
    assert sandbox.run(both, ALLOWED).answer == {"upload": "upload", "truth": "truth"}
    for name, given in (("truth", None), ("submissions.sqlite", truth)):
        ended = sandbox.run(job(private / "upload", hidden=hidden, truth=given, method=name), ALLOWED)
        assert ended.answer is None
        assert "Permission denied" in ended.stderr or "No such file" in ended.stderr


RUNS = """
import sys
from pathlib import Path
from tests.leaderboard.test_submissions_sandbox import job
from oysterbench_leaderboard.submissions.sandbox import sandbox
sandbox.WORKER = Path(sys.argv[1])
sandbox.run(job(sys.argv[2]), sandbox.Allowance(60.0, 60, 1_000_000_000, 1_000_000))
"""


@STARTED
def test_it_dies_with_the_server(doing, tmp_path):
    """Which is seen by a pipe whose other end nobody holds any more."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    doing(f"kept = open(job.path, 'rb')\n{FOREVER}")
    server = subprocess.Popen([sys.executable, "-c", RUNS, str(sandbox.WORKER), str(pipe)], cwd=ROOT)
    with open(pipe, "wb") as writer:
        ended = select.poll()
        ended.register(writer, 0)
        assert ended.poll(0) == []
        assert server.poll() is None
        server.kill()
        server.wait()
        assert ended.poll(60_000) == [(writer.fileno(), select.POLLERR)]


@STARTED
@pytest.mark.skipif(not can_hide(), reason="needs Landlock: Linux 5.13 or later")
def test_it_writes_nowhere_but_in_its_folder(doing, tmp_path):
    (tmp_path / "upload").write_text("carp")
    doing("""
        def refused(path):
            try:
                open(path, 'a')
            except OSError:
                return True
        beside = os.path.join(os.path.dirname(job.path), 'other')
        return {'places': [bool(refused(path)) for path in ('notes', job.path, beside, worker.__file__)]}""")
    answer = sandbox.run(job(tmp_path / "upload"), ALLOWED).answer
    assert answer == {"places": [False, True, True, True]}


@pytest.mark.parametrize("doing", ["namespaces"], indirect=True)
def test_in_namespaces_it_sees_code_and_its_own_files_and_writes_nowhere_but_in_its_folder(doing, tmp_path):
    (tmp_path / "upload").write_text("carp")
    (tmp_path / "other").write_text("tench")
    doing("""
        def refused(do, *what):
            try:
                do(*what)
            except OSError as error:
                return error.strerror
        open('notes', 'w').write('x')
        beside = os.path.join(os.path.dirname(job.path), 'other')
        libc = __import__('ctypes').CDLL(None)
        return {
            'upload': open(job.path).read(), 'beside': refused(open, beside), 'etc': os.listdir('/etc'),
            'written': [refused(open, path, 'w') for path in (job.path, '/x', worker.__file__)],
            'much': refused(open('much', 'w').write, 'x' * 900_000) or refused(open('more', 'w').write, 'x' * 900_000)
                or refused(open('most', 'w').write, 'x' * 900_000),
            'who': [os.getuid(), os.getgid()], 'alone': sorted(__import__('socket').if_nameindex()),
            'further': [libc.unshare(0x10000000), libc.unshare(0x40000000)],
        }""")
    answer = sandbox.run(job(tmp_path / "upload"), ALLOWED).answer
    assert answer == {
        "upload": "carp",
        "beside": "No such file or directory",
        "etc": ["ld.so.cache"],
        "written": ["Read-only file system"] * 3,
        "much": "No space left on device",
        "who": [65534, 65534],
        "alone": [[1, "lo"]],
        "further": [-1, -1],
    }


REFUSES = "#!/bin/sh\necho no right to do so >&2\nexit 1"


@pytest.mark.parametrize("doing", ["namespaces"], indirect=True)
@pytest.mark.parametrize(("program", "why"), [(None, "is not installed"), (REFUSES, "no right to do so")])
def test_where_there_are_none_the_other_sandbox_is_used_and_said(doing, tmp_path, monkeypatch, program, why):
    if program is not None:
        (tmp_path / "bwrap").write_text(program)
        (tmp_path / "bwrap").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep if program else None)
    namespaces.missing.cache_clear()
    try:
        assert why in namespaces.missing()
        assert sandbox.in_force().endswith(f"no namespaces: {namespaces.missing()}")
        doing("return {'home': os.environ['HOME']}")
        assert "oysterbench-" in sandbox.run(job(), ALLOWED).answer["home"]
    finally:
        namespaces.missing.cache_clear()
