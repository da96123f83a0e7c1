"""A policy in a process of its own, which cannot read the ground truth: views go in and commands come out over pipes.

    python -m oysterbench.methods.policy_process REFERENCE

reads a line of JSON with the task, then for each view a line of JSON and its pixels; it writes a line of JSON for each
command, and a last one with `failure` or `end`. What the method prints goes to the log.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import IO, Any

import numpy as np

from oysterbench.core.errors import MachineError, MethodError, OysterbenchError
from oysterbench.core.helpers import module_command
from oysterbench.core.locks import scratch
from oysterbench.methods.finding import find_method
from oysterbench.methods.interfaces.steering import task_of
from oysterbench.methods.policy import commands
from oysterbench.methods.processes import (
    STDERR,
    ended_of,
    environment,
    report_of,
    secrets,
    supervised_command,
    threads,
)
from oysterbench.methods.steering import Steering, SteeringMethod, VehicleState, View, Views

LIMIT_S = 4 * 3600.0
"""Default time limit of a rollout, s."""


class PolicyProcess:
    """A method of the track steering whose `run` is executed in a process of its own."""

    track = "steering"

    def __init__(self, reference: str, limit_s: float = LIMIT_S, cores: int | None = None) -> None:
        """limit_s: time after which the process is ended; cores: number of cores for it, where several policies share a
        machine. Raises MethodError where the method cannot be found."""
        self.reference, self.limit_s, self.cores = reference, limit_s, cores
        self.name = find_method(reference).name
        self.cpu_s = 0.0  # of the last run, once that has ended

    def run(self, views: Views) -> Iterator[Steering]:
        """Yield a command for each view. Raises MethodError where the policy fails, MachineError where it was killed
        from outside, for lack of memory or by a person."""
        with scratch() as folder, tempfile.TemporaryFile() as report:
            words = module_command(__name__, self.reference)
            command = supervised_command(words, self.limit_s, report, secrets(), own=[folder])
            with open(folder / STDERR, "wb") as err:
                process = subprocess.Popen(
                    command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=err,
                    start_new_session=True,
                    pass_fds=[report.fileno()],
                    env=environment() | threads(self.cores) | {"TMPDIR": str(folder)},
                )
            try:
                assert process.stdin is not None
                assert process.stdout is not None
                yield from self._commands(views, process.stdin, process.stdout)
            except (BrokenPipeError, EOFError):
                process.wait()
                try:
                    ended = ended_of(report, self.limit_s, folder)
                except MachineError as error:
                    raise MachineError(
                        f"method {self.name!r}: {error}; the rollout is not counted, and the same command runs it again"
                    ) from None
                raise MethodError(f"method {self.name!r}: {ended.failure or 'it ended without output'}") from None
            finally:
                process.terminate()  # the supervisor ends everything that the policy started
                process.communicate()
                self.cpu_s = (report_of(report) or {}).get("cpu_s", 0.0)

    def _commands(self, views: Views, down: IO[bytes], up: IO[bytes]) -> Iterator[Steering]:
        _send(down, {"task": asdict(views.task)})
        for view in views:
            header = {"name": view.name, "time_s": view.time_s, "state": asdict(view.state)}
            _send(down, {**header, "shape": view.pixels.shape}, np.ascontiguousarray(view.pixels).tobytes())
            line = up.readline()
            if not line.endswith(b"\n"):
                raise EOFError
            reply = json.loads(line)
            if "failure" in reply:
                raise MethodError(str(reply["failure"]))
            if "end" in reply:
                return
            yield _steering(reply)


def _steering(reply: dict[str, Any]) -> Steering:
    """Build a command as the policy gave it; it is checked elsewhere."""
    shares = {key: np.array(reply[key], dtype=float) for key in reply if key.endswith("_probability")}
    return Steering(reply["name"], reply.get("yaw"), reply.get("pitch"), **shares)


def _send(pipe: IO[bytes], header: dict[str, Any], data: bytes = b"") -> None:
    pipe.write(json.dumps(header).encode() + b"\n" + data)
    pipe.flush()


def _received(pipe: IO[bytes]) -> Iterator[View]:
    """Yield the views as they arrive."""
    while line := pipe.readline():
        header = json.loads(line)
        shape = tuple(header["shape"])
        data = pipe.read(int(np.prod(shape)))
        pixels = np.frombuffer(data, np.uint8).reshape(shape).copy()
        yield View(header["name"], pixels, VehicleState(**header["state"]), header["time_s"])


def main(reference: str) -> None:
    """Run the policy on views from stdin, and write its commands to stdout."""
    up, down = os.fdopen(os.dup(1), "wb"), os.fdopen(os.dup(0), "rb")
    os.dup2(2, 1)  # what the method prints must not mix with the commands
    task = task_of(json.loads(down.readline())["task"])
    method: Any = find_method(reference)
    policy: SteeringMethod = method
    try:
        _send_commands(commands(policy, task, _received(down), "rollout"), up)
        _send(up, {"end": True})
    except OysterbenchError as error:
        _send(up, {"failure": str(error)})


def _send_commands(made: Iterable[tuple[View, Steering, tuple[int, int]]], up: IO[bytes]) -> None:
    for _, command, (yaw, pitch) in made:
        plain: dict[str, Any] = {"name": command.name, "yaw": yaw, "pitch": pitch}
        for key in ("yaw_probability", "pitch_probability"):
            if (given := getattr(command, key)) is not None:
                plain[key] = np.asarray(given, dtype=float).tolist()
        _send(up, plain)


if __name__ == "__main__":
    main(*sys.argv[1:])
