"""Program that runs in the sandbox (see `sandbox`): reads an upload and says what is wrong with it; or is given the
ground truth as well, and answers with numbers and sentences from a closed list.

    python -I sandbox_worker.py < JOB > ANSWER
    python -I sandbox_worker.py serve               the same for many jobs, on request of `fork_server`
"""

from __future__ import annotations

import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

import msgspec

from oysterbench_leaderboard.submissions.reading.predictions import check_predictions, open_upload
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.sandbox.fork_server import serve
from oysterbench_leaderboard.submissions.sandbox.sandbox import Job

MOST_REASON = 1000  # characters


def do(job: Job) -> dict[str, Any]:
    """Do a job and return its answer."""
    try:
        predictions = open_upload(Path(job.path), job.wanted, job.limits)
        if job.truth is None:
            return check_predictions(predictions, job.wanted)
    except Refusal as refusal:
        # A file that passed its check can be refused here only if the program has changed since.
        return {"refused": {"kind": refusal.kind, "reason": printable(refusal.reason)}}
    from oysterbench_leaderboard.submissions.scoring import score_predictions

    truth = {name: Path(path) for name, path in job.truth.items()}
    try:
        scored = score_predictions(predictions, job.wanted, truth, job.method, job.created)
    except Refusal as refusal:  # reported results only: in other uploads, a failure belongs to its sequence
        return {"refused": {"kind": refusal.kind, "reason": printable(refusal.reason)}}
    results = [record.to_dict() for record in scored.results]
    return {"results": results, "data_set": scored.data_set, "curves": scored.curves}


def printable(text: str) -> str:
    """Make a text one printable line of bounded length, whatever names it contains."""
    return "".join(c if c.isprintable() else " " for c in text)[:MOST_REASON]


def main() -> None:
    """Read a job from standard input, limit this process, and write the answer to standard output."""
    answer = os.dup(1)
    os.dup2(2, 1)  # so that nothing but the answer reaches standard output
    job = msgspec.json.decode(sys.stdin.buffer.read(), type=Job)
    if job.wanted.of_images:
        import cv2

        cv2.setNumThreads(0)
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))  # no new process or thread from here on, unless root
    with open(answer, "w", encoding="utf-8") as pipe:
        json.dump(do(job), pipe)


if __name__ == "__main__":
    serve(main) if sys.argv[1:] else main()
