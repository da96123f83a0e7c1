"""The web form: sign in with a token, send, view, publish and withdraw submissions. It works without scripts."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from oysterbench.evaluate.metrics import find_metric
from oysterbench.results.records import aggregate
from oysterbench.results.standings import PRIMARY
from oysterbench_leaderboard.site.links import Links
from oysterbench_leaderboard.site.render import environment, html
from oysterbench_leaderboard.storage.record import MOST_TEXT
from oysterbench_leaderboard.submissions.accounts.auth import Auth
from oysterbench_leaderboard.submissions.accounts.sessions import Sessions, check_origin, set_cookie
from oysterbench_leaderboard.submissions.accounts.tokens import Holder
from oysterbench_leaderboard.submissions.api import small_body
from oysterbench_leaderboard.submissions.catalogue import ELSEWHERE
from oysterbench_leaderboard.submissions.database import Submission
from oysterbench_leaderboard.submissions.reading.refusals import Refusal

TEMPLATES = Path(__file__).with_name("templates")
NEW = "/submit/new"
FIELDS = ("split", "method", "url", "summary")
STATES = {
    "queued": "is waiting to be scored",
    "running": "is being scored",
    "done": "has been scored",
    "failed": "could not be scored",
    "withdrawn": "has been withdrawn",
}
"""State -> description."""

REFRESH_S = 5
"""Interval at which the page of a pending submission reloads."""


class WebForm:
    """Pages under /submit."""

    def __init__(self, auth: Auth, links: Links) -> None:
        self.auth, self.service, self.links = auth, auth.service, links
        self.sessions = Sessions(auth.service)
        self.environment = environment(str(TEMPLATES))

    def routes(self) -> list[Route]:
        """Routes of the form."""
        refused = self._refused
        return [
            self.auth.route(NEW, refused, GET=self._new, POST=self._send),
            self.auth.route("/submit/sign-in", refused, POST=self._sign_in),
            self.auth.route("/submit/sign-out", refused, POST=self._sign_out),
            self.auth.route("/submit/{id:str}", refused, GET=self._one),
            self.auth.route("/submit/{id:str}/publish", refused, POST=self._publish),
            self.auth.route("/submit/{id:str}/withdraw", refused, POST=self._withdraw),
        ]

    # Pages:

    async def _new(self, request: Request) -> Response:
        return await self._form(request)

    async def _form(self, request: Request, error: str = "", status: int = 200) -> Response:
        """Page with the submission form for a team that is signed in, or else with the sign-in form."""
        value = self.sessions.value(request)
        holder = await run_in_threadpool(self.sessions.holder, value)
        own = await run_in_threadpool(self.service.of_team, holder.team) if holder else []
        context = {
            "title": "Submit",
            "team": holder.team if holder else "",
            "submissions": own,
            "splits": self.service.catalogue.public(),
            "fields": getattr(request.state, "fields", dict.fromkeys(FIELDS, "")),
            "most": MOST_TEXT,
            "limits": self.service.settings,
            "elsewhere": list(ELSEWHERE),
            "error": error,
        }
        return self._page(request, value, "submit_new.html", context, status)

    async def _one(self, request: Request) -> Response:
        return await self._submission(request)

    async def _submission(self, request: Request, error: str = "", status: int = 200) -> Response:
        value = self.sessions.value(request)
        holder = await self._signed_in(request, value)
        found = await run_in_threadpool(self.service.get, holder.team, request.path_params["id"])
        context = {
            "title": f"{found.method} on {found.split}",
            "submission": found,
            "words": STATES[found.state],
            "refresh_s": REFRESH_S if found.state in ("queued", "running") else 0,
            "error": error,
            **await run_in_threadpool(self._scored, found),
        }
        return self._page(request, value, "submit_one.html", context, status)

    def _scored(self, found: Submission) -> dict[str, Any]:
        """Fields of the record that the page shows, and the number of submissions ahead in the queue."""
        record = self.service.record(found)
        if record is None:
            return {"key": "", "rows": [], "score": None, "before": self.service.queued_before(found)}
        key = PRIMARY[record.track]
        metric = find_metric(key)
        rows = [
            {
                "sequence": result.sequence,
                "score": result.metrics.get(key),
                "coverage": result.metrics.get("coverage"),
                "failure": result.failure or "",
                "notes": result.notes,
            }
            for result in record.results
        ]
        return {
            "key": metric.heading if metric else key,
            "rows": rows,
            "score": aggregate(record.results)[0]["metrics"].get(key),
            "before": 0,
        }

    def _page(self, request: Request, value: str, template: str, context: dict[str, Any], status: int) -> Response:
        given = {"path": request.url.path, "csrf": self.sessions.csrf(value), "form": NEW, **context}
        page = HTMLResponse(html(template, self.links, given, self.environment), status)
        return set_cookie(request, page, value, self.links.page("/submit"))

    async def _refused(self, request: Request, refusal: Refusal) -> Response:
        """Render the page again, with the reason for the refusal."""
        path = request.url.path
        if refusal.kind in ("state", "text") and path.endswith(("/publish", "/withdraw")):
            try:
                return await self._submission(request, refusal.reason, refusal.status)
            except Refusal as worse:
                refusal = worse
        if path in (NEW, "/submit/sign-in", "/submit/sign-out"):
            return await self._form(request, refusal.reason, refusal.status)
        context = {"title": "Submission", "error": refusal.reason}
        return self._page(request, self.sessions.value(request), "submit_error.html", context, refusal.status)

    # Forms:

    async def _sign_in(self, request: Request) -> Response:
        fields, value = await self._fields(request)
        holder = await self.auth.holder(request, fields.get("token", "").strip())
        fresh = await run_in_threadpool(self.sessions.begin, holder, value)
        return self._go(request, NEW, fresh)

    async def _sign_out(self, request: Request) -> Response:
        _, value = await self._fields(request)
        await run_in_threadpool(self.sessions.end, value)
        return self._go(request, NEW, self.sessions.value(request))

    async def _send(self, request: Request) -> Response:
        check_origin(request)
        value = self.sessions.value(request)
        holder = await self._signed_in(request, value)

        def check_fields(fields: dict[str, str]) -> None:
            self.sessions.check(request, value, fields.get("csrf", ""))
            if not hasattr(request.state, "fields"):
                request.state.fields = {key: fields.get(key, "") for key in FIELDS}
            if " " in fields.get("split", ""):  # "SPLIT TRACK", one choice of the form
                fields["split"], _, fields["track"] = fields["split"].partition(" ")

        made, _ = await self.auth.submit(request, holder.team, check_fields)
        return self._go(request, f"/submit/{made.id}", value)

    async def _publish(self, request: Request) -> Response:
        _, value = await self._fields(request)
        holder = await self._signed_in(request, value)
        found = await self.auth.publish(holder.team, request.path_params["id"])
        return self._go(request, f"/submit/{found.id}", value)

    async def _withdraw(self, request: Request) -> Response:
        fields, value = await self._fields(request)
        holder = await self._signed_in(request, value)
        reason = fields.get("reason", "")
        found = await run_in_threadpool(self.service.withdraw, holder.team, request.path_params["id"], reason)
        return self._go(request, f"/submit/{found.id}", value)

    async def _fields(self, request: Request) -> tuple[dict[str, str], str]:
        """Read a small form of this site; return its fields and the session. Raises Refusal for any other form."""
        kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
        if kind != "application/x-www-form-urlencoded":
            raise Refusal("type", f"expected a form (application/x-www-form-urlencoded), got {kind!r:.80}")
        body = (await small_body(request, self.service.settings.idle_s)).decode("ascii", "replace")
        try:
            fields = dict(parse_qsl(body, keep_blank_values=True, max_num_fields=20))
        except ValueError as error:
            raise Refusal("request", f"the form cannot be read: {error}") from None
        value = self.sessions.value(request)
        self.sessions.check(request, value, fields.get("csrf", ""))
        return fields, value

    async def _signed_in(self, request: Request, value: str) -> Holder:
        holder = await run_in_threadpool(self.sessions.holder, value)
        if holder is None:
            raise Refusal("token", f"sign in with a token of your team first, at {self.links.page(NEW)}")
        request.state.team = holder.team
        return holder

    def _go(self, request: Request, path: str, value: str) -> Response:
        page = RedirectResponse(self.links.page(path), 303)
        return set_cookie(request, page, value, self.links.page("/submit"))
