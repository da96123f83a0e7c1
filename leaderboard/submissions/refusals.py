"""What a server refuses, and how it says so: a kind for programs and logs, and a sentence for people."""

from __future__ import annotations

from oysterbench.core.errors import OysterbenchError

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
