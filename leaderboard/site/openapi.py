"""OpenAPI 3.1 description of all addresses; msgspec makes its schemas from the dataclasses of the responses."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from oysterbench.version import VERSION
from oysterbench_leaderboard.site.render import REPRESENTATIONS
from oysterbench_leaderboard.site.routes import FILES, PATTERNS, ROUTES, Route

ABOUT = {
    "track": "track of a board",
    "split": "data set, as spelled in page addresses",
    "method": "method, as spelled in page addresses",
    "board": "id of a board",
    "digest": "SHA-256 of a record, or at least its first 8 digits, which redirect to the full one",
}


@dataclass(frozen=True)
class RequestError:
    """Response in place of a page. error: message; see: addresses of other pages -> what is there."""

    error: str
    see: dict[str, str]


def describe(root: str = "", static: bool = False) -> dict[str, Any]:
    """Make the OpenAPI document. root: prefix that a proxy adds; static: for exported files, which take no queries."""
    _, schemas = _schemas((RequestError, *(kind for route in ROUTES for kind in route.answers.values())))
    paths: dict[str, Any] = {}
    for route in ROUTES:
        if static:
            route = replace(route, query=())
            if route.path == "/compare":
                continue
        bare = "/index" if route.path == "/" else route.path
        paths[route.path] = {"get": _operation(route, "", {"text/html": {"schema": {"type": "string"}}})}
        for suffix, (_, media) in REPRESENTATIONS.items():
            schema = _answer(route) if suffix == ".json" else {"type": "string"}
            content = {media.partition(";")[0]: {"schema": schema}}
            paths[f"{bare}{suffix}"] = {"get": _operation(route, suffix, content)}
    for path, summary in FILES.items():
        if static and path == "/health":
            continue
        content = {"application/json": {"schema": {"type": "object"}}}
        paths[path] = {"get": _get(_name(path, ""), summary, _parts(path), content)}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "oysterbench leaderboard",
            "version": VERSION,
            "description": "Every page has other representations: append .json, .csv or .tex to its address.",
            "license": {"name": "CC BY 4.0", "url": "https://creativecommons.org/licenses/by/4.0/"},
        },
        "servers": [{"url": "." if static else root or "/"}],
        "paths": paths,
        "components": {"schemas": schemas},
    }


def _operation(route: Route, suffix: str, content: dict[str, Any]) -> dict[str, Any]:
    parameters = _parts(route.path)
    for one in route.query:
        listed = one.schema.get("type") == "array"
        explode = {"style": "form", "explode": True} if listed else {}
        about = {"name": one.name, "in": "query", "description": one.about, "required": one.required}
        parameters.append({**about, **explode, "schema": dict(one.schema)})
    summary = route.summary if not suffix else f"{route.summary} As {REPRESENTATIONS[suffix][0]}."
    return _get(_name(route.path, suffix), summary, parameters, content)


def _get(name: str, summary: str, parameters: list[dict[str, Any]], content: dict[str, Any]) -> dict[str, Any]:
    refused = {"application/json": {"schema": {"$ref": "#/components/schemas/RequestError"}}}
    responses = {
        "200": {"description": "as asked", "content": content},
        "304": {"description": "the client's copy is up to date"},
        "404": {"description": "not found, with what exists", "content": refused},
    }
    if any(parameter["in"] == "query" for parameter in parameters):
        responses["400"] = {"description": "invalid request, with the reason", "content": refused}
    return {"operationId": name, "summary": summary, "parameters": parameters, "responses": responses}


def _name(path: str, suffix: str) -> str:
    words = re.findall(r"\w+", path) or ["index"]
    return "_".join(["get", *words, *([suffix[1:]] if suffix else [])])


def _parts(path: str) -> list[dict[str, Any]]:
    return [
        {
            "name": part,
            "in": "path",
            "required": True,
            "description": ABOUT[part],
            "schema": {"type": "string", "pattern": f"^{PATTERNS[part]}$"},
        }
        for part in re.findall(r"\{(\w+)\}", path)
    ]


def _answer(route: Route) -> dict[str, Any]:
    """The schema of a page's JSON."""
    keys = ("path", "title", *route.answers)
    found, _ = _schemas((str, str, *route.answers.values()))
    return {"type": "object", "properties": dict(zip(keys, found, strict=True)), "required": list(keys)}


def _schemas(kinds: Iterable[Any]) -> tuple[tuple[dict[str, Any], ...], dict[str, Any]]:
    """Schemas of the types, and of the dataclasses in them by name; all their keys are always present, and a missing
    number is null."""
    found, named = msgspec.json.schema_components(kinds, ref_template="#/components/schemas/{name}")
    for schema in named.values():
        schema["required"] = list(schema.get("properties", {}))
        for key, of in schema.get("properties", {}).items():
            if of.get("type") == "number":
                schema["properties"][key] = {"anyOf": [of, {"type": "null"}]}
    return found, named
