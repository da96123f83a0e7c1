"""The texts that describe a submission: checked by the client before it sends them, and by the server."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.storage.record import MOST_TEXT, check_text
from oysterbench_leaderboard.submissions.reading.refusals import Refusal


@dataclass(frozen=True)
class Form:
    """A sender's description of a submission; an empty track means the split's first."""

    method: str
    split: str
    track: str = ""
    url: str = ""
    summary: str = ""

    def check(self) -> None:
        """Raises Refusal naming a field that no page could show, an empty method, or a URL that is not http(s)."""
        for key in ("method", "url", "summary"):
            check_words(key, getattr(self, key))
        if not self.method.strip():
            raise Refusal("text", "expected the name of the method, got an empty one")
        if self.url and not self.url.startswith(("https://", "http://")):
            raise Refusal("text", f"key 'url': expected https://... or nothing, got {self.url!r:.60}")


def check_words(key: str, text: str) -> None:
    """Refuse a text that no page could show in one line. key: a key of `MOST_TEXT`. Raises Refusal."""
    try:
        check_text(key, text, MOST_TEXT[key])
    except ResultError as error:
        raise Refusal("text", str(error).removeprefix("record: ")) from None
