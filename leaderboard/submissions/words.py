"""The texts that describe a submission: checked by the client before it sends them, and by the server."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.storage.record import MOST_TEXT, check_address, check_text
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
        """Raises Refusal for a field that no page could show, an empty method, or an address that cannot be opened."""
        for key in ("method", "url", "summary"):
            check_words(key, getattr(self, key))
        if not self.method.strip():
            raise Refusal("text", "expected the name of the method, got an empty one")
        with _refusing():
            check_address(self.url)


def check_words(key: str, text: str) -> None:
    """Refuse a text that no page could show in one line. key: a key of `MOST_TEXT`. Raises Refusal."""
    with _refusing():
        check_text(key, text, MOST_TEXT[key])


@contextmanager
def _refusing() -> Iterator[None]:
    """Turn what is wrong with a record's text into a Refusal."""
    try:
        yield
    except ResultError as error:
        raise Refusal("text", str(error).removeprefix("record: ")) from None
