"""Running the site: the complete application, which loads new records while it is up."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import anyio.to_thread
from starlette.applications import Starlette

from oysterbench.core.errors import OysterbenchError
from oysterbench_leaderboard.boards.index import BoardIndex
from oysterbench_leaderboard.boards.literature import literature
from oysterbench_leaderboard.site import datasets, render
from oysterbench_leaderboard.site.server import application
from oysterbench_leaderboard.site.site import Site

LOOK_S = 2.0
"""Interval of looking for new records in the folder."""

LOG = logging.getLogger("uvicorn.error")


def site_of(index: BoardIndex, form: str = "", accepted: Sequence[Mapping[str, Any]] = ()) -> Site:
    """Site of an index: everything that pages are made from. form, accepted: see `Site`."""
    return Site(index, literature(), form, accepted)


class Watch:
    """Watches the board's folders for new files."""

    def __init__(self, index: BoardIndex) -> None:
        self.index = index
        self._seen = self._times()

    def _times(self) -> tuple[int, ...]:
        found = []
        for kind in ("records", "changes"):
            try:
                found.append((self.index.store.folder / kind).stat().st_mtime_ns)
            except FileNotFoundError:
                found.append(0)
        return tuple(found)

    def look(self) -> bool:
        """Load what is new since the last look; return whether there was anything."""
        times = self._times()
        if times == self._seen:
            return False
        self.index.refresh()
        self._seen = times
        return True


async def _keep_up(index: BoardIndex) -> None:
    watch = Watch(index)
    while True:
        await asyncio.sleep(LOOK_S)
        try:
            await anyio.to_thread.run_sync(watch.look)
        except (OysterbenchError, OSError) as error:  # may be temporary, such as a full disk
            LOG.error("new records were not loaded: %s", error)
        except Exception:  # a fault of ours: the next records should be looked for all the same
            LOG.exception("new records were not loaded")


def whole(
    index: BoardIndex,
    submissions: Path | None = None,
    truths: Iterable[str] = (),
    workers: int | None = None,
    root: str = "",
    scheduler: str = "",
    metrics: str = "",
) -> Starlette:
    """Make the whole application. submissions: private folder of the submission service, None for no service; truths:
    SPLIT=FOLDER, the ground truth that it scores against, with `workers` workers or on the cluster of a scheduler;
    root: prefix that a proxy adds to our addresses; metrics: HOST:PORT for Prometheus, empty for none."""
    taken: Any = None
    closing: list[Callable[[], None]] = []
    if submissions is not None:
        from oysterbench_leaderboard.submissions.web import Submissions, open_service

        service = open_service(submissions, truths, index.store, index.refresh)
        taken = Submissions(service, render.server_links(root), workers, scheduler)
        if metrics:
            from oysterbench_leaderboard.submissions.metrics import serve_metrics

            closing.append(serve_metrics(service, metrics))
    site = site_of(index, taken.form, taken.service.catalogue.public()) if taken else site_of(index)
    app = application(site, taken.routes() if taken else (), root)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            if taken is not None:
                await stack.enter_async_context(taken.running())
            for close in closing:
                stack.callback(close)
            await anyio.to_thread.run_sync(datasets.known)  # takes seconds: no visitor should have to wait
            task = asyncio.create_task(_keep_up(index))
            try:
                yield
            finally:
                task.cancel()
                with suppress(asyncio.CancelledError):
                    await task

    app.router.lifespan_context = lifespan
    return app
