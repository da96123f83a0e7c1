"""Entry point of the command, guarded against interrupts from the start: its imports take a while."""

from __future__ import annotations

import os
import signal

INTERRUPTED = 130


def main() -> None:
    """Run `oysterbench`."""
    # An exception during imports would pass through third-party code, which may mistake it for something else.
    early = signal.getsignal(signal.SIGINT) == signal.default_int_handler
    if early:
        signal.signal(signal.SIGINT, _leave)
    from oysterbench.cli.interrupts import heed_termination
    from oysterbench.cli.main import main as command

    if early:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    heed_termination()
    command()


def _leave(number: int, frame: object) -> None:
    os.write(2, b"oysterbench: interrupted before anything was done\n")
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
