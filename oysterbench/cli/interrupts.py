"""What an interruption leaves of each command, and what to type then."""

from __future__ import annotations

import shlex
import signal
import sys

TERMINATED = 128 + signal.SIGTERM

RESUMED = {
    "download": "downloaded data is kept",
    "experiment": "finished training runs and the last checkpoint are kept",
    "release": "sequences that were read are kept",
    "render": "finished frames are kept",
    "run": "finished runs are kept",
    "segment": "finished images are kept",
    "train": "the last checkpoint is kept",
    "tune": "finished trials are kept",
}
"""Command -> what is kept of it; the same command resumes from there."""

BEGUN_ANEW = {
    "eval": "finished frames are kept, and results of finished runs are in results.json; the same command starts again "
    "from the first run, `oysterbench run` resumes",
    "publish": "the tree is as it was before",
    "publish-model": "the tree is as it was before",
    "systems": "an unfinished system is built again",
    "translate": "written images stay, but the set is incomplete: choose another --out, or delete it",
}
"""Command -> what is left of it, of those that do not go on."""


class Terminated(KeyboardInterrupt):
    """SIGTERM came, as from a scheduler or a service manager: what is under way is cleared up as after Ctrl-C."""


def heed_sigterm() -> None:
    """Let SIGTERM, unless somebody else heeds it, raise Terminated."""
    if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _terminated)


def _terminated(number: int, frame: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # once is enough
    raise Terminated


def interruption(command: str, what: str = "interrupted") -> str:
    """A sentence for who has just interrupted a command of this name.

    >>> interruption("view")
    'interrupted; nothing was written'
    >>> interruption("map", "terminated")
    'terminated; nothing was written'
    """
    if command in RESUMED:
        typed = shlex.join(["oysterbench", *sys.argv[1:]])
        return f"{what}; {RESUMED[command]}, and the same command resumes from there: {typed}"
    return f"{what}; {BEGUN_ANEW.get(command, 'nothing was written')}"
