"""What runs in the sandbox (see `sandbox`): reads an upload and says what is wrong with it; or is given the truth, and
says numbers and sentences of a closed list.

    python -I sandbox_worker.py < JOB > ANSWER
    python -I sandbox_worker.py serve               the same for many, as `fork_server` asks for it
"""

from __future__ import annotations

import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

import msgspec

from oysterbench_leaderboard.submissions.fork_server import serve
from oysterbench_leaderboard.submissions.predictions import check_predictions, open_predictions
from oysterbench_leaderboard.submissions.refusals import Refusal
from oysterbench_leaderboard.submissions.sandbox import Job

MOST_REASON = 1000  # characters


def do(job: Job) -> dict[str, Any]:
    """The answer to a job."""
    try:
        predictions = open_predictions(Path(job.path), job.wanted, job.limits)
        if job.truth is None:
            return check_predictions(predictions, job.wanted)
    except Refusal as refusal:
        # A file that was checked before can be refused again only where the program has changed.
        return {"refused": {"kind": refusal.kind, "reason": printable(refusal.reason)}}
    from oysterbench_leaderboard.submissions.scoring import score_predictions

    truth = {name: Path(path) for name, path in job.truth.items()}
    try:
        scored = score_predictions(predictions, job.wanted, truth, job.method, job.created)
    except Refusal as refusal:  # of results that others computed: all else has a failure of its sequence
        return {"refused": {"kind": refusal.kind, "reason": printable(refusal.reason)}}
    results = [record.to_dict() for record in scored.results]
    return {"results": results, "data_set": scored.data_set, "curves": scored.curves}


def printable(text: str) -> str:
    """In one line of bounded length, whatever the names in it hold."""
    return "".join(c if c.isprintable() else " " for c in text)[:MOST_REASON]


def main() -> None:
    """Read, limit, answer."""
    answer = os.dup(1)
    os.dup2(2, 1)  # nothing but the answer goes where the answer goes
    job = msgspec.json.decode(sys.stdin.buffer.read(), type=Job)
    if job.wanted.of_images:
        import cv2

        cv2.setNumThreads(0)
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))  # no process nor thread from here on, but where it is root
    with open(answer, "w", encoding="utf-8") as pipe:
        json.dump(do(job), pipe)


if __name__ == "__main__":
    serve(main) if sys.argv[1:] else main()
