"""Refusals by a server: a kind for programs and logs, and a sentence for people."""

from __future__ import annotations

import re

from oysterbench.core.errors import OysterbenchError

OPTIONS = re.compile(
    r",? or [^;()]*\([^()]*--[a-z][^()]*\)[^;]*"  # ", or name the format (--format tum)"
    r"| \([^()]*--[a-z][^()]*\)"  # " (--sort)"
    r"|; [^;]*--estimate-kind[^;]*"
)
"""Matches advice to set an option of `oysterbench eval`."""

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
    "full": 507,
}
"""Kind of a refusal -> HTTP status."""


class Refusal(OysterbenchError):
    """A refused request: `kind` is a key of STATUS, the message is for the client. retry_s: seconds after which to try
    again; 0 where that would not help."""

    def __init__(self, kind: str, reason: str, retry_s: int = 0) -> None:
        super().__init__(reason)
        self.kind = kind
        self.retry_s = retry_s

    @property
    def reason(self) -> str:
        """The message in one line."""
        return " ".join(str(self).split())

    @property
    def status(self) -> int:
        """HTTP status of the response."""
        return STATUS[self.kind]


FAILED = {
    "time": "scoring exceeded the time limit",
    "memory": "scoring exceeded the memory limit",
    "crash": "scoring ended without a result; the operators can see why and try again",
    "refused": "the upload can no longer be read by this version; send it again",
    "absent": "the split is no longer served here",
    "none": "no sequence could be scored; ",
}
"""Cause of a failure -> message for the team: sentences that reveal no ground truth."""

SERVER_FAULTS = tuple(FAILED[cause] for cause in ("crash", "refused", "absent"))
"""Messages of failures that may not recur once the server is repaired."""


def without_options(text: str) -> str:
    """Remove advice to set an option from the text of an `eval` error: a submission is read without options.

    >>> without_options("poses.tum:3: expected increasing timestamps; sort the poses by time (--sort)")
    'poses.tum:3: expected increasing timestamps; sort the poses by time'
    >>> without_options("a.csv: expected a header; correct it, or name the format (--format tum or euroc)")
    'a.csv: expected a header; correct it'
    """
    return OPTIONS.sub("", text)
