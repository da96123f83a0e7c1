"""Export of the whole site as files, for any web host or none: pages, their other representations, records. Links work
from any folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from pathlib import Path

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.core.permissions import umask
from oysterbench.hub.canonical import canonical
from oysterbench_leaderboard.boards.board import STATES, BoardInfo, Query
from oysterbench_leaderboard.publishing.truths import Stated
from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.datasets import all_data_sets
from oysterbench_leaderboard.site.links import FileLinks, file_of, numbered, pair_path
from oysterbench_leaderboard.site.openapi import describe
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.board import MOST_ROWS
from oysterbench_leaderboard.site.pages.compare import PAIRED
from oysterbench_leaderboard.site.paths import board_path, data_path, method_path, record_path, slug, split_path
from oysterbench_leaderboard.site.representations import represent
from oysterbench_leaderboard.site.routes import ROUTES
from oysterbench_leaderboard.site.site import Site

MARK = ".oysterbench-board"
"""File that marks a folder as written by the export, so that it may be replaced."""

Progress = Callable[[int, int], None]
"""Called with the number of pages written so far, and of all pages."""

Report = Callable[[str, str], None]
"""Called with the digest of a damaged file, and what is wrong with it."""


@dataclass(frozen=True)
class Work:
    """A page to be written. path: that of its file, which may differ from the page's own where that needs a server."""

    path: str
    make: Callable[[], Page]


def export(
    site: Site,
    folder: str | os.PathLike[str],
    progress: Progress = lambda done, of: None,
    report: Report = lambda file, why: None,
) -> int:
    """Write the site in place of an earlier export; return the number of files.

    The folder is swapped once everything is written: a host that serves it never shows half a site. Unchanged files are
    kept with their timestamps, so that copying the site elsewhere transfers only what is new. Damaged records and
    curves are reported, and the site is written without them, and so are comparisons of records that were scored
    against several ground truths. Raises ResultError where the folder holds something else.
    """
    target = Path(folder).resolve()
    if target.exists() and (not target.is_dir() or (any(target.iterdir()) and not (target / MARK).is_file())):
        raise ResultError(
            f"{target}: expected an empty folder, or one that `oysterbench leaderboard build` wrote; it was left "
            "unchanged"
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    try:
        count = 0
        for name, data in files(site, progress, report):
            _write(temporary / name, data, target / name)
            count += 1
        temporary.chmod(0o777 & ~umask())
        _swap(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return count


def files(
    site: Site, progress: Progress = lambda done, of: None, report: Report = lambda file, why: None
) -> Iterator[tuple[str, bytes]]:
    """Yield names and bytes of all files; the same records give the same files."""
    digests, curves = _whole(site, report)
    work = list(_work(site, digests, report))
    there = {one.path for one in work} | {"/openapi"}
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


def _whole(site: Site, report: Report) -> tuple[list[str], dict[str, str]]:
    """Digests of the records on all boards whose files are whole, sorted; and of these, record -> its curves, where
    they are whole, too. What is damaged is reported."""
    digests, curves = [], {}
    for digest in sorted(digest for info in site.index.boards() for digest in _digests(site, info)):
        file = digest
        try:
            found = site.record(digest).curves
            digests.append(digest)
            if file := found:
                site.store.curves(found)
                curves[digest] = found
        except OysterbenchError as error:
            report(file, str(error))
    return digests, curves


def _work(site: Site, digests: Collection[str], report: Report) -> Iterator[Work]:
    """Pages to be written. digests: of the records that have one, and are compared; those that cannot be are
    reported"""
    makers, whole = {route.path: route.make for route in ROUTES}, set(digests)

    def work(path: str, route: str, asked: object = (), **given: str) -> Work:
        return Work(path, partial(makers[route], site, given, asked))

    for route in ROUTES:
        if not route.parts and not route.query:
            yield work(route.path, route.path)
    for name in all_data_sets(site):
        yield work(data_path(name), "/data/{split}", split=slug(name))
    pairs: set[tuple[str, str]] = set()
    for info in site.index.boards():
        given = {"track": slug(info.track), "split": slug(info.split)}
        for number in range(1, site.index.page(info.id, Query(size=MOST_ROWS)).pages + 1):
            query = Query(page=number, size=MOST_ROWS)
            if info.newest:
                path = numbered(split_path(info.track, info.split), number)
                yield work(path, "/boards/{track}/{split}", query, **given)
            path = numbered(board_path(info), number)
            yield work(path, "/boards/{track}/{split}/{board}", query, **given, board=info.id)
        if info.newest:
            first = [row.digest for row in site.index.page(info.id, Query(size=PAIRED)).rows if row.digest in whole]
            stated = [Stated.of(digest, site.record(digest)) for digest in first]
            odd = site.contradicted(stated)
            for digest, why in odd.items():
                report(digest, f"its comparisons: {why}")
            pairs |= set(permutations([digest for digest in first if digest not in odd], 2))
    for digest in digests:
        yield work(record_path(digest), "/records/{digest}", digest=digest)
    for method in sorted({method for method, _, _ in site.index.methods()}):
        yield work(method_path(method), "/methods/{method}", method=slug(method))
    for pair in sorted(pairs):
        yield work(pair_path(*pair), "/compare", pair)


def _digests(site: Site, info: BoardInfo) -> Iterator[str]:
    """Digests of all records of a board, whatever their state."""
    query = Query(states=STATES, size=MOST_ROWS)
    for number in range(1, site.index.page(info.id, query).pages + 1):
        yield from (row.digest for row in site.index.page(info.id, replace(query, page=number)).rows)


def _write(path: Path, data: bytes, before: Path) -> None:
    """Write a file; where the one in the earlier export has the same bytes, link to it instead."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        if not before.is_symlink() and before.stat().st_size == len(data) and before.read_bytes() == data:
            os.link(before, path)
            return
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError):
        pass
    path.write_bytes(data)


def _swap(new: Path, target: Path) -> None:
    """Replace a folder by another, restoring it where that fails."""
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
