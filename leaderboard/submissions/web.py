"""What a site that takes submissions adds to its pages: routes to mount, and a dispatcher to start."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from pathlib import Path

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.routing import Route

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.site.links import Links
from oysterbench_leaderboard.storage.store import RecordStore
from oysterbench_leaderboard.submissions.accounts.auth import Auth
from oysterbench_leaderboard.submissions.api import routes as api_routes
from oysterbench_leaderboard.submissions.catalogue import served_splits
from oysterbench_leaderboard.submissions.form import NEW, TEMPLATES, WebForm
from oysterbench_leaderboard.submissions.queue import Dispatcher
from oysterbench_leaderboard.submissions.service import Service
from oysterbench_leaderboard.submissions.settings import load_settings

__all__ = ["NEW", "TEMPLATES", "Submissions"]


class Submissions:
    """Submissions to a service as part of a site: `application(site, more=submissions.routes())`, then
    `submissions.attach(app)`.

    Requests must arrive with their bodies unread: no middleware may read bodies before.
    """

    def __init__(self, service: Service, links: Links, workers: int | None = None, scheduler: str = "") -> None:
        self.service = service
        self._links = links
        self._dispatcher = Dispatcher(service, workers, scheduler)

    @property
    def form(self) -> str:
        """Path of the form."""
        return NEW

    def routes(self) -> list[Route]:
        """Routes, to be placed before the site's own, which include /submit itself: the page on how to submit."""
        auth = Auth(self.service)
        return [*api_routes(auth), *WebForm(auth, self._links).routes()]

    def attach(self, app: Starlette) -> None:
        """Score submissions for as long as an application is up."""

        @asynccontextmanager
        async def lifespan(app: Starlette) -> AsyncIterator[None]:
            async with self.running():
                yield

        app.router.lifespan_context = lifespan

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Score queued submissions. At the end, those being scored go back into the queue."""
        self._dispatcher.start()
        try:
            yield
        finally:
            await run_in_threadpool(self._dispatcher.stop)
            self.service.close()


def _check_private(folder: Path, board: Path) -> None:
    """Refuse a private folder in a board or in the tree of a hub: both are copied to the public as they are."""
    place = folder.resolve()
    if board.resolve() in (place, *place.parents):
        raise ResultError(f"--submissions {folder}: expected a folder outside the board {board}, which is public")
    for tree in (place, *place.parents):
        if (tree / "index.json").is_file() and (tree / "manifests").is_dir():
            raise ResultError(f"--submissions {folder}: expected a folder outside the tree {tree}, which is public")


def open_service(
    folder: Path, truths: Iterable[str], store: RecordStore, changed: Callable[[], None] = lambda: None
) -> Service:
    """Open the service of a private folder. truths: SPLIT=FOLDER, for hidden splits and for public ones that are kept
    elsewhere; SPLIT is a name, or a recipe (.toml). changed: called after a record was published or withdrawn.

    Every public split is served: estimates are scored if it is rendered here, and results are accepted. Raises
    ResultError where the folder is in one that is public, where ground truth is missing or belongs to another split, or
    where the service cannot read uploads.
    """
    _check_private(folder, store.folder)
    settings = load_settings(folder)
    (store.folder / "records").mkdir(parents=True, exist_ok=True)  # a board without any can be backed up as well
    service = Service(settings, served_splits(truths, folder / "catalogue"), store, changed)
    service.self_test()
    return service
