"""What a site that takes submissions has beside its pages: routes to be mounted, and workers to be started."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.routing import Route

from oysterbench_leaderboard.site.links import Links
from oysterbench_leaderboard.submissions.api import routes as api_routes
from oysterbench_leaderboard.submissions.form import NEW, TEMPLATES, WebForm
from oysterbench_leaderboard.submissions.gate import Gate
from oysterbench_leaderboard.submissions.queue import Workers
from oysterbench_leaderboard.submissions.service import Service

__all__ = ["NEW", "TEMPLATES", "Submissions"]


class Submissions:
    """Of a service. `application(site, more=submissions.routes())`, then `submissions.attach(app)`.

    Requests reach it with all their bytes still to come: no middleware may read bodies before it.
    """

    def __init__(self, service: Service, links: Links, workers: int | None = None) -> None:
        self.service = service
        self._links = links
        self._workers = workers

    @property
    def form(self) -> str:
        """Path of the form."""
        return NEW

    def routes(self) -> list[Route]:
        """To be put before the site's own, which has /submit itself: how to submit."""
        gate = Gate(self.service)
        return [*api_routes(gate), *WebForm(gate, self._links).routes()]

    def attach(self, app: Starlette) -> None:
        """Score for as long as an application is up."""

        @asynccontextmanager
        async def lifespan(app: Starlette) -> AsyncIterator[None]:
            async with self.running():
                yield

        app.router.lifespan_context = lifespan

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Score what is queued. When it ends, what is being scored goes back into the queue."""
        workers = Workers(self.service, self._workers)
        workers.start()
        try:
            yield
        finally:
            await run_in_threadpool(workers.stop)
            self.service.close()
