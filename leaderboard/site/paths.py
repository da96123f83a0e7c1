"""Addresses of pages. What stands in them is a slug, a board's id or a digest, whatever methods and splits are called,
so that an address is also a safe name of a file."""

from __future__ import annotations

import hashlib
import re

from oysterbench_leaderboard.board import BoardInfo

SLUG = "[a-z0-9][a-z0-9_+~-]{0,79}"
"""Pattern of a slug: lower case, as some file systems do not tell cases apart; no dot, which begins a suffix."""

_PLAIN = re.compile("[a-z0-9][a-z0-9_+-]{0,59}")


def slug(name: str) -> str:
    """A name that is plain as it is, any other as what is plain in it and a hash of the whole.

    >>> slug("gtsam_vi"), slug("Über <b>")
    ('gtsam_vi', 'ber-b~61070d1dcc')
    """
    if _PLAIN.fullmatch(name):
        return name
    plain = re.sub("[^a-z0-9]+", "-", name.lower()).strip("-")[:40] or "x"
    return f"{plain}~{hashlib.sha256(name.encode()).hexdigest()[:10]}"


def split_path(track: str, split: str) -> str:
    """The newest board of a split."""
    return f"/boards/{slug(track)}/{slug(split)}"


def board_path(board: BoardInfo) -> str:
    """A board by its id, which stays the same when a newer one takes the place above."""
    return f"{split_path(board.track, board.split)}/{board.id}"


def method_path(method: str) -> str:
    """All records of a method."""
    return f"/methods/{slug(method)}"


def record_path(digest: str) -> str:
    """The permalink of a record."""
    return f"/records/{digest}"


def data_path(split: str) -> str:
    """A data set."""
    return f"/data/{slug(split)}"
