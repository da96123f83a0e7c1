"""The HTTP API: `POST /api/submissions` and what follows it, authorised by a token in the header Authorization."""

from __future__ import annotations

import asyncio
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from oysterbench.results.records import aggregate
from oysterbench.results.standings import PRIMARY
from oysterbench_leaderboard.submissions.accounts.auth import Auth
from oysterbench_leaderboard.submissions.database import Submission
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.service import Service

MOST_BODY = 4000
"""Size limit of a small request body, bytes."""


def routes(auth: Auth) -> list[Route]:
    """Routes of the HTTP API."""
    service = auth.service

    async def team(request: Request) -> str:
        kind, _, token = request.headers.get("authorization", "").partition(" ")
        holder = await auth.holder(request, token.strip() if kind.lower() == "bearer" else "")
        request.state.team = holder.team
        return holder.team

    async def answer(found: Submission, status: int = 200) -> Response:
        return JSONResponse(await run_in_threadpool(shown, service, found), status)

    async def splits(request: Request) -> Response:
        if "authorization" in request.headers:  # a client about to upload learns of a wrong token before it does
            await team(request)
        limits = {key: getattr(service.settings, key) for key in ("file_bytes", "upload_bytes", "per_day", "per_split")}
        return JSONResponse({"splits": service.catalogue.public(), "limits": limits})

    async def send(request: Request) -> Response:
        made, new = await auth.submit(request, await team(request))
        found = await answer(made, 201 if new else 200)
        if not new:
            found.headers["Connection"] = "close"  # a duplicate: do not wait for the rest of its body
        return found

    async def listed(request: Request) -> Response:
        found = await run_in_threadpool(service.of_team, await team(request))
        return JSONResponse({"submissions": [brief(one) for one in found]})

    async def one(request: Request) -> Response:
        return await answer(await run_in_threadpool(service.get, await team(request), request.path_params["id"]))

    async def publish(request: Request) -> Response:
        return await answer(await auth.publish(await team(request), request.path_params["id"]))

    async def withdraw(request: Request) -> Response:
        of = await team(request)
        reason = (await small_body(request, service.settings.idle_s)).decode(errors="replace")
        return await answer(await run_in_threadpool(service.withdraw, of, request.path_params["id"], reason))

    async def refuse(request: Request, refusal: Refusal) -> Response:
        headers = {"WWW-Authenticate": "Bearer"} if refusal.kind == "token" else {}
        return JSONResponse({"error": refusal.kind, "reason": refusal.reason}, refusal.status, headers)

    return [
        auth.route("/api/submissions/splits", refuse, GET=splits),
        auth.route("/api/submissions", refuse, GET=listed, POST=send),
        auth.route("/api/submissions/{id:str}", refuse, GET=one),
        auth.route("/api/submissions/{id:str}/publish", refuse, POST=publish),
        auth.route("/api/submissions/{id:str}/withdraw", refuse, POST=withdraw),
    ]


def brief(submission: Submission) -> dict[str, Any]:
    """Fields of a submission that a list of submissions shows."""
    keys = (
        "id",
        "state",
        "reason",
        "track",
        "split",
        "method",
        "url",
        "summary",
        "digest",
        "size",
        "created",
        "updated",
    )
    return {
        **{key: getattr(submission, key) for key in keys},
        "published": submission.published or None,
        "page": f"/submit/{submission.id}",
    }


def shown(service: Service, submission: Submission) -> dict[str, Any]:
    """Everything that a team may see of its own submission."""
    found = brief(submission)
    if submission.state == "queued":
        found["queued_before"] = service.queued_before(submission)
    record = service.record(submission)
    if record is not None:
        row = aggregate(record.results)[0]
        metrics = dict(row["metrics"])
        found["score"] = {key: metrics[key] for key in (PRIMARY[record.track], "coverage") if key in metrics}
        found["metrics"] = metrics
        found["failures"] = {r.sequence: r.failure for r in record.results if r.failure is not None}
        found["record"] = record.to_dict()
    return found


async def small_body(request: Request, most_s: float) -> bytes:
    """Read a request body of at most MOST_BODY bytes. Raises Refusal where it is longer, or takes more than `most_s`
    seconds: a client that never ended it would hold its connection for good."""
    body = b""
    try:
        async with asyncio.timeout(most_s):
            async for chunk in request.stream():
                body += chunk
                if len(body) > MOST_BODY:
                    raise Refusal("size", f"expected at most {MOST_BODY} bytes, got more")
    except TimeoutError:
        raise Refusal(
            "slow", f"expected the whole request within {most_s:g} s, got {len(body)} bytes of it; send it again"
        ) from None
    return body
