"""The command, guarded from its first moment: what it stands on takes a while to be imported."""

from __future__ import annotations

import os
import signal
import sys

INTERRUPTED = 130


def main() -> None:
    """Run `oysterbench`."""
    # An exception amid imports would pass through other people's code, which may take it for something else.
    early = signal.getsignal(signal.SIGINT) == signal.default_int_handler
    if early:
        signal.signal(signal.SIGINT, _leave)
    from oysterbench.cli.main import main as command

    if early:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, _end)
    command()


def _leave(number: int, frame: object) -> None:
    os.write(2, b"oysterbench: interrupted before anything was done\n")
    os._exit(INTERRUPTED)


def _end(number: int, frame: object) -> None:
    """Leave by way of whatever has to be put in order, such as the processes and semaphores of a pool."""
    signal.signal(number, signal.SIG_IGN)
    os.write(2, b"\noysterbench: terminated; what was finished is kept, and the same command goes on from there\n")
    sys.exit(128 + number)


if __name__ == "__main__":
    main()
