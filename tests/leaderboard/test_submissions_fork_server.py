"""Readers that are forked: what one does, none of the others knows of."""

from __future__ import annotations

import os
import signal
import textwrap
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest

from oysterbench_leaderboard.submissions.sandbox import namespaces, sandbox
from oysterbench_leaderboard.submissions.sandbox.fork_server import ForkServer
from oysterbench_leaderboard.submissions.sandbox.sandbox import Ended, never
from tests.helpers.pool import lay_split
from tests.helpers.served import make_service
from tests.helpers.waiting import until
from tests.leaderboard.test_submissions_sandbox import ALLOWED, FOREVER, PRELUDE, job

pytestmark = pytest.mark.skipif(bool(namespaces.missing()), reason=f"no namespaces: {namespaces.missing()}")


@pytest.fixture
def forks(tmp_path, monkeypatch):
    """A fork server whose readers do what the file that they are sent says, in Python."""
    script = tmp_path / "evil.py"
    body = "    found = {}\n    exec(open(job.path).read(), globals() | {'found': found, 'job': job})\n    return found"
    script.write_text(PRELUDE.format(worker=str(sandbox.WORKER), body=body))
    monkeypatch.setattr(sandbox, "WORKER", script)
    with closing(sandbox.fork_server()) as server:
        yield server


def read(forks: ForkServer, folder: object, text: str) -> Ended:
    """What reading that comes to."""
    path = f"{folder}/{abs(hash(text))}"
    with open(path, "w") as file:
        file.write(textwrap.dedent(text))
    return sandbox.run(job(path), ALLOWED, never, forks)


LOOKS = """
import ctypes, fcntl
libc = ctypes.CDLL(None, use_errno=True)
def refused(do, *what):
    try:
        do(*what)
    except OSError as error:
        return error.strerror
found |= {
    'processes': [name for name in os.listdir('/proc') if name.isdigit()],
    'files': sorted(map(int, os.listdir('/proc/self/fd')))[:5], 'more files': refused(os.fstat, 5),
    'folder': [os.getcwd(), os.listdir('.'), os.listdir('/job')],
    'capabilities': [line.split()[1] for line in open('/proc/self/status') if line.startswith(('CapPrm', 'CapEff'))],
    'mounts': [libc.mount(b'x', b'/job', b'tmpfs', 0, None), libc.umount2(b'/proc', 2), libc.unshare(0x20000)],
    'further': libc.unshare(0x10000000),
    'network': __import__('socket').if_nameindex(),
    'who': [os.getuid(), os.getgid()],
    'written': [refused(open, path, 'w') for path in ('/x', worker.__file__, '/proc/sys/vm/drop_caches', job.path)],
}
"""


def test_a_reader_sees_itself_and_what_it_was_sent(forks, tmp_path):
    (tmp_path / "other").write_text("tench")
    ended = read(forks, tmp_path, LOOKS + f"found['other'] = refused(open, {str(tmp_path / 'other')!r})")
    assert ended.answer == {
        "processes": ["1"],
        "files": [0, 1, 2, 3, 4],
        "more files": "Bad file descriptor",
        "folder": ["/job", [], []],
        "capabilities": ["0" * 16] * 2,
        "mounts": [-1] * 3,
        "further": -1,
        "network": [[1, "lo"]],
        "who": [65534, 65534],
        "written": ["Read-only file system"] * 3 + ["Operation not permitted"],
        "other": "No such file or directory",
    }, ended.stderr


LEAVES = """
import builtins, ctypes
open('left', 'w').write('carp')
worker.left = builtins.left = os.environ['LEFT'] = 'carp'
found['shared'] = ctypes.CDLL(None).shmget(0x6f79, 4096, 0o1666)
"""
FINDS = """
import builtins, ctypes
found |= {
    'file': os.path.exists('left'), 'module': hasattr(worker, 'left') or hasattr(builtins, 'left'),
    'environment': 'LEFT' in os.environ, 'folders': open('/proc/self/mounts').read().count(' /job '),
    'shared': ctypes.CDLL(None).shmget(0x6f79, 4096, 0o666),
}
"""


def test_nothing_of_an_upload_reaches_the_next(forks, tmp_path):
    assert read(forks, tmp_path, LEAVES).answer["shared"] >= 0
    found = read(forks, tmp_path, FINDS).answer
    nothing = {"file": False, "module": False, "environment": False, "shared": -1}
    assert found == {**nothing, "folders": 2}, "that of the fork server, and its own over it"


@pytest.mark.parametrize(
    "harm",
    [
        "for process in (-1, 0, 1): os.kill(process, 9)\nos.abort()",
        "__import__('ctypes').string_at(0)",
        "[os.close(n) for n in range(4)]\nos._exit(0)",
        "resource.setrlimit = None\nsys.modules.clear()\nos._exit(3)",
        "if os.fork() == 0:\n    while True: time.sleep(1)\nos._exit(0)",
    ],
)
def test_a_reader_that_ends_badly_harms_itself_alone(forks, tmp_path, harm):
    assert read(forks, tmp_path, "found['fine'] = 1").answer == {"fine": 1}
    server = forks.pid
    assert read(forks, tmp_path, harm).answer is None
    assert read(forks, tmp_path, "found['fine'] = 1").answer == {"fine": 1}
    assert forks.pid == server


def test_uploads_are_read_at_a_time_and_readers_end_with_the_server(forks, tmp_path):
    with ThreadPoolExecutor(1) as pool:
        endless = pool.submit(read, forks, tmp_path, FOREVER)
        assert read(forks, tmp_path, "found['fine'] = 1").answer == {"fine": 1}
        assert not endless.done()
        os.kill(forks.pid, signal.SIGKILL)
        with pytest.raises(OSError, match="the fork server ended"):
            endless.result()


def test_a_server_that_died_is_started_again(forks, tmp_path):
    assert read(forks, tmp_path, "found['fine'] = 1").answer == {"fine": 1}
    before = forks.pid
    os.kill(before, signal.SIGKILL)
    until(lambda: forks.pid is None)
    assert read(forks, tmp_path, "found['fine'] = 1").answer == {"fine": 1}
    assert forks.pid not in (None, before)


HINDERED = """
from oysterbench_leaderboard.submissions.sandbox import fork_server
def refuse(result):
    raise OSError("no mounts here")
fork_server._done = refuse
fork_server.serve(print)
"""


@pytest.mark.parametrize(("program", "why"), [("", "the fork server ended"), (HINDERED, "OSError: no mounts here")])
def test_where_no_reader_can_be_forked_an_upload_is_read_by_a_process_of_its_own(tmp_path, monkeypatch, program, why):
    lay_split(tmp_path / "splits", "pool-test")
    script = tmp_path / "hindered.py"
    script.write_text(program)
    monkeypatch.setattr(sandbox, "fork_server", lambda: ForkServer(script, sandbox.ENVIRONMENT))
    with closing(make_service(tmp_path)) as service:
        service.self_test()
    log = (tmp_path / "private" / "private.log").read_text()
    assert "in a process of its own" in log
    assert why in log


def test_what_it_had_begun_to_start_ends_with_it(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    (tmp_path / "bwrap").write_text(f"#!/bin/sh\nsleep 1000 &\necho $! > {pipe}\nwait")
    (tmp_path / "bwrap").chmod(0o755)
    server = ForkServer(tmp_path / "absent.py", {"PATH": f"{tmp_path}:/usr/bin:/bin"})
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(sandbox.run, job(), ALLOWED, never, server)
        begun = f"/proc/{int(pipe.read_text())}/exe"
        assert os.path.exists(begun)
        server.close()
        until(lambda: not os.path.exists(begun))
        with pytest.raises(OSError, match="the fork server ended"):
            asked.result()
