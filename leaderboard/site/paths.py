"""Addresses of pages. They contain only slugs, board ids and digests, whatever methods and splits are called, so that
an address is also a safe file name."""

from __future__ import annotations

import hashlib
import re

from oysterbench_leaderboard.boards.board import BoardInfo

SLUG = "[a-z0-9][a-z0-9_+~-]{0,79}"
"""Pattern of a slug: lower case, as some file systems ignore case; no dot, which starts a suffix."""

_PLAIN = re.compile("[a-z0-9][a-z0-9_+-]{0,59}")


def slug(name: str) -> str:
    """Slug of a name: a plain name unchanged, any other as its plain characters with a hash of the whole.

    >>> slug("gtsam_vi"), slug("Über <b>")
    ('gtsam_vi', 'ber-b~61070d1dcc')
    """
    if _PLAIN.fullmatch(name):
        return name
    plain = re.sub("[^a-z0-9]+", "-", name.lower()).strip("-")[:40] or "x"
    return f"{plain}~{hashlib.sha256(name.encode()).hexdigest()[:10]}"


def split_path(track: str, split: str) -> str:
    """Path of the newest board of a split."""
    return f"/boards/{slug(track)}/{slug(split)}"


def board_path(board: BoardInfo) -> str:
    """Path of a board by its id, which remains valid when a newer board takes over the split's path."""
    return f"{split_path(board.track, board.split)}/{board.id}"


def method_path(method: str) -> str:
    """Path of the page with all records of a method."""
    return f"/methods/{slug(method)}"


def record_path(digest: str) -> str:
    """The permalink of a record."""
    return f"/records/{digest}"


def data_path(split: str) -> str:
    """Path of a data set's page."""
    return f"/data/{slug(split)}"
