"""What each command keeps after an interruption, and what to type next."""

from __future__ import annotations

import shlex
import signal
import sys

import click

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
"""Command that can be resumed -> what is kept of it."""

STARTED_OVER = ("release", "segment", "train")
"""Those of them that --again makes start over each time it is given; others go on with what it began."""

TOLD = STARTED_OVER
"""Those of them that say when they have started over (`started_over`)."""
BEGUN = "oysterbench.started_over"

CLOSED_LOOP = "--closed-loop"
"""Option with which `run` and `eval` drive policies: finished rollouts are kept, and --again makes all of them anew."""

BEGUN_ANEW = {
    "eval": "finished frames are kept, and results of finished runs are in results.json; the same command starts again "
    "from the first run, `oysterbench run` resumes",
    "publish": "the tree is as it was before",
    "publish-model": "the tree is as it was before",
    "systems": "an unfinished system is built again",
    "translate": "written images stay, but the set is incomplete, and refused as such; the same command writes it anew",
}
"""Command that cannot be resumed -> what is left of it."""


class Terminated(KeyboardInterrupt):
    """SIGTERM was received, as from a scheduler or service manager, or SIGHUP, as the terminal was closed; work in
    progress is cleaned up as after Ctrl-C."""


def heed_termination() -> None:
    """Make SIGTERM and SIGHUP raise Terminated, unless another handler is installed or, as by nohup, one is ignored."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _terminated)


def _terminated(number: int, frame: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # once is enough
    raise Terminated


def started_over() -> None:
    """Note that from here on the command that runs, if any, resumes without --again what --again has begun, and takes
    nothing of what was there before."""
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta[BEGUN] = True


def interruption(command: str, what: str = "interrupted", begun: bool = True) -> str:
    """Message for a user who has interrupted the command of this name. begun: whether it had `started_over`, of
    those that say so.

    >>> interruption("view")
    'interrupted; nothing was written'
    >>> interruption("map", "terminated")
    'terminated; nothing was written'
    """
    if command in RESUMED or (command == "eval" and CLOSED_LOOP in sys.argv):
        kept = "finished rollouts are kept" if CLOSED_LOOP in sys.argv else RESUMED[command]
        over = command in STARTED_OVER or CLOSED_LOOP in sys.argv
        words = [word for word in sys.argv[1:] if not over or word != "--again"]
        if command in TOLD and words != sys.argv[1:] and not begun:
            typed = shlex.join(["oysterbench", *sys.argv[1:]])
            return f"{what} before anything was started over; the same command begins: {typed}"
        typed = shlex.join(["oysterbench", *words])
        same = "the same command" if words == sys.argv[1:] else "the command without --again"
        return f"{what}; {kept}, and {same} resumes from there: {typed}"
    if command == "leaderboard" and "rescore" in sys.argv and "--dry-run" not in sys.argv:
        return f"{what}; the records that were scored again are kept"
    return f"{what}; {BEGUN_ANEW.get(command, 'nothing was written')}"
