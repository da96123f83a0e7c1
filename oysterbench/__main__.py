"""The command, guarded from its first moment: what it stands on takes a while to be imported."""

from __future__ import annotations

import os
import signal

INTERRUPTED = 130


def main() -> None:
    """Run `oysterbench`."""
    # An exception amid imports would pass through other people's code, which may take it for something else.
    early = signal.getsignal(signal.SIGINT) == signal.default_int_handler
    if early:
        signal.signal(signal.SIGINT, _leave)
    from oysterbench.cli.interrupts import heed_sigterm
    from oysterbench.cli.main import main as command

    if early:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    heed_sigterm()
    command()


def _leave(number: int, frame: object) -> None:
    os.write(2, b"oysterbench: interrupted before anything was done\n")
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
