"""What an interruption leaves of each command, and what to type then."""

from __future__ import annotations

import shlex
import sys

RESUMED = {
    "download": "what was fetched is kept",
    "experiment": "finished trainings and the last checkpoint are kept",
    "release": "sequences that were read are kept",
    "render": "finished frames are kept",
    "run": "finished runs are kept",
    "segment": "finished pictures are kept",
    "train": "the last checkpoint is kept",
    "tune": "finished trials are kept",
}
"""Command -> what is kept of it; the same command resumes from there."""

BEGUN_ANEW = {
    "eval": "finished frames are kept, and results of finished runs are in results.json; typed again, it begins with "
    "the first run: `oysterbench run` resumes where it was",
    "publish": "the tree is as it was before",
    "publish-model": "the tree is as it was before",
    "systems": "a system that was not finished is built anew",
    "translate": "pictures that were written stay, and the set is not complete: choose another --out, or delete it",
}
"""Command -> what is left of it, of those that do not go on."""


def interruption(command: str) -> str:
    """A sentence for who has just interrupted a command of this name.

    >>> interruption("view")
    'interrupted; nothing was written'
    """
    if command in RESUMED:
        typed = shlex.join(["oysterbench", *sys.argv[1:]])
        return f"interrupted; {RESUMED[command]}, and the same command resumes from there: {typed}"
    return f"interrupted; {BEGUN_ANEW.get(command, 'nothing was written')}"
