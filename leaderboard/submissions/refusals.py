"""What a server refuses, and how it says so: a kind for programs and logs, and a sentence for people."""

from __future__ import annotations

import re

from oysterbench.core.errors import OysterbenchError

OPTIONS = re.compile(
    r",? or [^;()]*\([^()]*--[a-z][^()]*\)[^;]*"  # ", or name the format (--format tum)"
    r"| \([^()]*--[a-z][^()]*\)"  # " (--sort)"
    r"|; [^;]*--estimate-kind[^;]*"
)
"""Advice to set an option of `oysterbench eval`."""

STATUS = {
    "token": 401,
    "origin": 403,
    "absent": 404,
    "state": 409,
    "size": 413,
    "type": 415,
    "format": 422,
    "name": 422,
    "archive": 422,
    "split": 422,
    "text": 422,
    "request": 400,
    "slow": 408,
    "limit": 422,
    "quota": 429,
    "guessing": 429,
    "busy": 503,
    "failed": 500,
}
"""Kind of a refusal -> HTTP status."""


class Refusal(OysterbenchError):
    """A request that is not met: `kind` is a key of STATUS, the message is for the one who asked. retry_s: when it may
    be asked again; 0 where that would not help."""

    def __init__(self, kind: str, reason: str, retry_s: int = 0) -> None:
        super().__init__(reason)
        self.kind = kind
        self.retry_s = retry_s

    @property
    def reason(self) -> str:
        """In one line."""
        return " ".join(str(self).split())

    @property
    def status(self) -> int:
        """Of the HTTP answer."""
        return STATUS[self.kind]


FAILED = {
    "time": "scoring exceeded the time limit",
    "memory": "scoring exceeded the memory limit",
    "crash": "scoring ended without a result; the operators can see why and try again",
    "refused": "the upload can no longer be read by this version; send it again",
    "absent": "the split is no longer served here",
    "none": "no sequence could be scored; ",
}
"""Why a submission failed, for its team: sentences that no truth is in."""

SERVER_FAULTS = tuple(FAILED[cause] for cause in ("crash", "refused", "absent"))
"""Those that a server which was mended may not give again."""


def without_options(text: str) -> str:
    """The text of an error of `eval` without its advice to set an option: a submission is read without any.

    >>> without_options("poses.tum:3: expected increasing timestamps; sort the poses by time (--sort)")
    'poses.tum:3: expected increasing timestamps; sort the poses by time'
    >>> without_options("a.csv: expected a header; correct it, or name the format (--format tum or euroc)")
    'a.csv: expected a header; correct it'
    """
    return OPTIONS.sub("", text)
