"""The whole site as files, for any web host or none: pages, their other forms, records; links work from a folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from oysterbench.core.errors import ResultError
from oysterbench.hub.canonical import canonical
from oysterbench_leaderboard.board import BoardInfo, Query
from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.datasets import all_data_sets
from oysterbench_leaderboard.site.links import FileLinks, file_of, numbered, pair_path
from oysterbench_leaderboard.site.openapi import describe
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.board import MOST_ROWS, STATES, board_page
from oysterbench_leaderboard.site.pages.compare import PAIRED, compare_page
from oysterbench_leaderboard.site.pages.data import data_page, split_page
from oysterbench_leaderboard.site.pages.home import home_page
from oysterbench_leaderboard.site.pages.literature import literature_page
from oysterbench_leaderboard.site.pages.log import log_page
from oysterbench_leaderboard.site.pages.method import method_page
from oysterbench_leaderboard.site.pages.prose import about_page, submit_page
from oysterbench_leaderboard.site.pages.record import record_page
from oysterbench_leaderboard.site.paths import board_path, data_path, method_path, record_path, slug, split_path
from oysterbench_leaderboard.site.representations import represent
from oysterbench_leaderboard.site.site import Site

MARK = ".oysterbench-board"
"""A file that says that a folder was written here, and may be replaced."""

Progress = Callable[[int, int], None]
"""Called with the number of pages that are written, and of all."""


@dataclass(frozen=True)
class Work:
    """A page to be written. path: of its file; it may differ from the page's own where that needs a server."""

    path: str
    make: Callable[[], Page]


def export(site: Site, folder: str | os.PathLike[str], progress: Progress = lambda done, of: None) -> int:
    """Write the site, and put it in the place of what was there; how many files.

    The folder is swapped when all is written: a host that serves it never shows half a site. Files whose bytes are the
    same are kept as they are, with their times, so that a copy to elsewhere sends only what is new. Raises ResultError
    where the folder holds something else.
    """
    target = Path(folder).resolve()
    if target.exists() and (not target.is_dir() or (any(target.iterdir()) and not (target / MARK).is_file())):
        raise ResultError(
            f"{target}: expected an empty folder, or one that `oysterbench leaderboard build` wrote; it was left alone"
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    try:
        count = 0
        for name, data in files(site, progress):
            _write(temporary / name, data, target / name)
            count += 1
        temporary.chmod(0o755)
        _swap(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return count


def files(site: Site, progress: Progress = lambda done, of: None) -> Iterator[tuple[str, bytes]]:
    """Names and bytes of all files; the same records give the same."""
    work = list(_work(site))
    there = {one.path for one in work} | {"/openapi"}
    digests = sorted({one.path.split("/")[2] for one in work if one.path.startswith("/records/")})
    curves = {digest: found for digest in digests if (found := site.record(digest).curves)}
    there |= {f"{record_path(digest)}/record" for digest in digests}
    there |= {f"{record_path(digest)}/curves" for digest in curves}
    for k, one in enumerate(work):
        page = replace(one.make(), path=one.path, query={})
        yield file_of(one.path), render.page_html(page, FileLinks(one.path, there)).encode()
        for suffix in render.REPRESENTATIONS:
            yield file_of(one.path, suffix), represent(page, suffix)
        progress(k + 1, len(work))
    for digest in digests:
        yield f"records/{digest}/record.json", site.store.data(digest)
    for digest, found in curves.items():
        yield f"records/{digest}/curves.json", canonical(site.store.curves(found))
    for name in render.ASSETS:
        yield f"static/{name}", render.asset(name)
    yield "openapi.json", canonical(describe(static=True))
    yield MARK, b"Written by `oysterbench leaderboard build`, which may replace this folder.\n"


def _work(site: Site) -> Iterator[Work]:
    yield Work("/", lambda: home_page(site))
    for path, make in (
        ("/data", data_page),
        ("/literature", literature_page),
        ("/submit", submit_page),
        ("/log", log_page),
        ("/about", about_page),
    ):
        yield Work(path, lambda make=make: make(site))  # type: ignore[misc]
    for name in all_data_sets(site):
        yield Work(data_path(name), lambda name=name: split_page(site, slug(name)))  # type: ignore[misc]
    pairs: set[tuple[str, str]] = set()
    for info in site.index.boards():
        yield from _board(site, info)
        for digest in _digests(site, info):
            yield Work(record_path(digest), lambda digest=digest: record_page(site, digest))  # type: ignore[misc]
        if info.newest:
            first = [row.digest for row in site.index.page(info.id, Query(size=PAIRED)).rows]
            pairs |= set(combinations(first, 2))
    for method in sorted({method for method, _, _ in site.index.methods()}):
        yield Work(method_path(method), lambda method=method: method_page(site, slug(method)))  # type: ignore[misc]
    for a, b in sorted({(a, b) for x, y in pairs for a, b in ((x, y), (y, x))}):
        yield Work(pair_path(a, b), lambda a=a, b=b: compare_page(site, a, b))  # type: ignore[misc]


def _board(site: Site, info: BoardInfo) -> Iterator[Work]:
    pages = site.index.page(info.id, Query(size=MOST_ROWS)).pages
    for path, board in ((split_path(info.track, info.split), None), (board_path(info), info.id)):
        for number in range(1, pages + 1) if info.newest or board else ():
            query = Query(page=number, size=MOST_ROWS)
            yield Work(
                numbered(path, number),
                lambda board=board, query=query: board_page(  # type: ignore[misc]
                    site, slug(info.track), slug(info.split), board, query
                ),
            )


def _digests(site: Site, info: BoardInfo) -> Iterator[str]:
    number, pages = 1, 1
    while number <= pages:
        found = site.index.page(info.id, Query(states=STATES, page=number, size=MOST_ROWS))
        pages, number = found.pages, number + 1
        yield from (row.digest for row in found.rows)


def _write(path: Path, data: bytes, before: Path) -> None:
    """A file; the one that was there before where it is the same."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        if not before.is_symlink() and before.stat().st_size == len(data) and before.read_bytes() == data:
            os.link(before, path)
            return
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError):
        pass
    path.write_bytes(data)


def _swap(new: Path, target: Path) -> None:
    """Put a folder in the place of another."""
    if not target.exists():
        os.replace(new, target)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    os.replace(target, old / "old")
    try:
        os.replace(new, target)
    except OSError:
        os.replace(old / "old", target)
        raise
    shutil.rmtree(old, ignore_errors=True)
