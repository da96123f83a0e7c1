"""The limited process: it takes its freedom from itself before it reads anything (see `limited`).

    python -I child.py '{"wall_s": 60, "cpu_s": 60, "memory_bytes": 4e9, "file_bytes": 6e7}' < JOB > ANSWER

JOB is an object with the key do: "check" (reads what was sent; it is given no truth, and may say what is wrong) or
"score" (is given the truth, and says numbers and sentences of a closed list).
"""

import ctypes
import json
import os
import resource
import signal
import sys

PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS = 1, 38  # linux/prctl.h
CLONE_NEWNET, CLONE_NEWUSER = 0x40000000, 0x10000000  # linux/sched.h
OPEN_FILES = 64
MOST_REASON = 1000  # characters


def limit(allowance):
    """No network where the kernel lets it go; bounded in all else, and gone when the server is."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_PDEATHSIG, ctypes.c_ulong(signal.SIGKILL), 0, 0, 0)
    libc.prctl(PR_SET_NO_NEW_PRIVS, ctypes.c_ulong(1), 0, 0, 0)
    if libc.unshare(CLONE_NEWNET) != 0:  # needs a right that a user of its own gives
        libc.unshare(CLONE_NEWUSER | CLONE_NEWNET)
    memory, files = int(allowance["memory_bytes"]), int(allowance["file_bytes"])
    for kind, most in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_FSIZE, files),
        (resource.RLIMIT_NOFILE, OPEN_FILES),
    ):
        resource.setrlimit(kind, (most, most))
    # At the first limit the kernel says why it ends the process, at the second it does not.
    resource.setrlimit(resource.RLIMIT_CPU, (int(allowance["cpu_s"]), int(allowance["cpu_s"]) + 2))


def alone():
    """No process nor thread from here on; root is not held by this, but by all else."""
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))


def do(job):
    """The answer to a job."""
    from pathlib import Path

    from oysterbench_leaderboard.submissions.archive import Limits
    from oysterbench_leaderboard.submissions.bundle import check_bundle, open_bundle
    from oysterbench_leaderboard.submissions.catalogue import Wanted
    from oysterbench_leaderboard.submissions.refusals import Refusal

    wanted = Wanted.from_dict(job["wanted"])
    if wanted.of_images:
        import cv2

        cv2.setNumThreads(0)
    alone()
    try:
        bundle = open_bundle(Path(job["path"]), wanted, Limits(**job["limits"]))
        if job["do"] == "check":
            return check_bundle(bundle, wanted)
    except Refusal as refusal:
        # A file that was checked before can be refused again only where the program has changed.
        return {"refused": {"kind": refusal.kind, "reason": printable(refusal.reason)}}
    from oysterbench_leaderboard.submissions.scoring import score_bundle

    truth = {name: Path(path) for name, path in job["truth"].items()}
    scored = score_bundle(bundle, wanted, truth, job["method"], job["created"], wanted.hidden)
    results = [record.to_dict() for record in scored.results]
    return {"results": results, "data_set": scored.data_set, "curves": scored.curves}


def printable(text):
    """In one line of bounded length, whatever the names in it hold."""
    return "".join(c if c.isprintable() else " " for c in text)[:MOST_REASON]


def main():
    """Limit, read, answer."""
    limit(json.loads(sys.argv[1]))
    answer = os.dup(1)
    os.dup2(2, 1)  # nothing but the answer goes where the answer goes
    job = json.load(sys.stdin)
    with open(answer, "w", encoding="utf-8") as pipe:
        json.dump(do(job), pipe)


if __name__ == "__main__":
    main()
