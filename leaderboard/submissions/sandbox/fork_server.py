"""A fork server: one process that has loaded the modules for reading, and forks a reader for each upload.

Starting Python with its libraries takes a second of processor time; a fork takes milliseconds. The server's side is
ForkServer. The other side, `serve`, runs in namespaces (`namespaces`), is given no user's file, and has one privilege
that the sandbox lacks: to create mounts and further namespaces. With it, each reader gets its own processes, /proc,
folder, network and IPC; the reader then drops the privilege for good, and enters the sandbox with its limits.

A keeper process stands in between: it reports its reader's exit code on its channel, and kills the reader when nobody
listens there any more. The upload is passed as a sealed, read-only copy in memory, so that its reader can reach no file
of the server's, not even through a descriptor.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import gc
import importlib
import json
import os
import resource
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import IO, Any, NoReturn

from oysterbench.methods.sandbox import Sandbox
from oysterbench_leaderboard.submissions.sandbox import namespaces

UPLOAD = "/proc/self/fd/3"
"""Path at which a reader finds the upload: the descriptor after its three standard streams."""

LOADED = (
    "cv2",
    "oysterbench.annotations",
    "oysterbench.core.trajectory.archive",
    "oysterbench.core.trajectory.text",
    "oysterbench.evaluate.slam.validate",
    "oysterbench.methods.interfaces.steering",
    "oysterbench.tracks.images",
    "oysterbench_leaderboard.submissions.reading.reported",
    "oysterbench_leaderboard.submissions.reading.times",
)
"""Modules that readers import lazily, loaded before the first fork."""

MOST_MESSAGE = 1 << 20
FOLDER_BYTES = 1 << 12  # of the fork server's own folder, which it does not use
CLONE_NEWNS, CLONE_NEWIPC, CLONE_NEWPID, CLONE_NEWNET = 0x00020000, 0x08000000, 0x20000000, 0x40000000  # linux/sched.h
MS_RDONLY, MS_NOSUID_NODEV_NOEXEC = 1, 14  # linux/mount.h
CAPABILITY_VERSION = 0x20080522  # linux/capability.h
SEALS = fcntl.F_SEAL_SEAL | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE


class ForkServer:
    """The server's side. The process is started on the first upload, and again after it has died.

    program: script that calls `serve` when its argument is "serve"
    """

    def __init__(self, program: Path, environment: Mapping[str, str]) -> None:
        self._program, self._environment = str(program), environment
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None
        # bubblewrap dies with the thread that started it, so start it from one that lasts.
        self._starter = ThreadPoolExecutor(1, "fork-server")

    def run(self, sandbox: Sandbox, upload: str, streams: Sequence[IO[bytes]], wall_s: float) -> int | None:
        """Run a reader of an upload with these standard streams; return its exit code, or None where it took longer
        than `wall_s`. Raises OSError where no reader could be forked."""
        ours, theirs = socket.socketpair()
        with ours:
            with theirs, open(os.memfd_create("upload", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING), "wb") as copy:
                with open(upload, "rb") as source:
                    shutil.copyfileobj(source, copy, 1 << 20)
                copy.flush()
                fcntl.fcntl(copy, fcntl.F_ADD_SEALS, SEALS)
                self._send(asdict(sandbox), [*(stream.fileno() for stream in streams), copy.fileno(), theirs.fileno()])
            ours.settimeout(wall_s)
            try:
                code = ours.recv(16)
            except TimeoutError:
                return None
        if not code:
            streams[-1].seek(0)
            why = streams[-1].read(MOST_MESSAGE).decode(errors="replace")
            raise OSError(f"the fork server ended, or could not fork: {why}")
        return int(code)

    @property
    def pid(self) -> int | None:
        """Process ID of the fork server; None where it is not running."""
        return self._process.pid if self._process is not None and self._process.poll() is None else None

    def close(self) -> None:
        """Kill the fork server and its process group."""
        with self._lock:
            self._end()
        self._starter.shutdown()

    def _send(self, settings: dict[str, Any], files: list[int]) -> None:
        with self._lock:
            if self.pid is None:
                self._end()
                self._starter.submit(self._start).result()
            assert self._control is not None
            socket.send_fds(self._control, [json.dumps(settings).encode()], files)

    def _start(self) -> None:
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            command = [sys.executable, "-IB", self._program, "serve"]
            self._process = subprocess.Popen(
                namespaces.inside(command, [self._program], FOLDER_BYTES, may_mount=True),
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                env=self._environment,
                start_new_session=True,
            )

    def _end(self) -> None:
        if self._process is not None and self._control is not None:
            if self.pid is not None:  # together with anything that it was about to start
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._control.close()


def serve(read: Callable[[], None]) -> None:
    """Fork a reader for each message until the server is gone. read: what a reader does, with its standard streams and
    UPLOAD. Raises RuntimeError where this process has other threads."""
    control = socket.socket(fileno=0)
    for name in LOADED:
        importlib.import_module(name)
    sys.modules["cv2"].setNumThreads(0)
    gc.freeze()
    if os.listdir("/proc/self/task") != [str(os.getpid())]:
        raise RuntimeError("threads run: what they hold, forked processes would wait for, for ever")
    while True:
        message, files, _, _ = socket.recv_fds(control, MOST_MESSAGE, 5)
        if not message:
            return
        if os.fork() == 0:
            _end_after(partial(_keep, json.loads(message), files, read), files[2])
        for file in files:
            os.close(file)
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG) != (0, 0):  # keepers that have ended
                pass


def _end_after(do: Callable[[], None], stderr: int) -> NoReturn:
    """Call `do`, then exit this process at once, without running any code of its parent."""
    try:
        os.dup2(stderr, 2)
        do()
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(1)


def _keep(settings: dict[str, Any], files: list[int], read: Callable[[], None]) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    _done(libc.unshare(CLONE_NEWNS | CLONE_NEWIPC | CLONE_NEWPID | CLONE_NEWNET))
    reader = os.fork()
    if reader == 0:
        _end_after(partial(_read, libc, settings, files[:-1], read), files[2])
    channel, ended = files[-1], os.pidfd_open(reader)
    if ended not in select.select([ended, channel], [], [])[0]:
        os.kill(reader, signal.SIGKILL)
    _, status, used = os.wait4(reader, 0)
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGKILL and used.ru_utime + used.ru_stime >= settings["cpu_s"]:
        code = -signal.SIGXCPU  # the first process of a namespace does not receive SIGXCPU
    os.write(channel, str(code).encode())


def _read(libc: ctypes.CDLL, settings: dict[str, Any], files: list[int], read: Callable[[], None]) -> None:
    for number, file in enumerate(files):
        os.dup2(file, number)
    os.closerange(len(files), resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    os.setsid()
    folder = namespaces.FOLDER.encode()
    size = f"size={2 * settings['file_bytes']}".encode()
    _done(libc.mount(b"tmpfs", folder, b"tmpfs", MS_NOSUID_NODEV_NOEXEC, size))
    _done(libc.mount(b"proc", b"/proc", b"proc", MS_NOSUID_NODEV_NOEXEC | MS_RDONLY, None))
    os.chdir(folder)
    _done(libc.capset(struct.pack("=Ii", CAPABILITY_VERSION, 0), bytes(24)))
    Sandbox(**settings).enter()
    read()


def _done(result: int) -> None:
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
