"""The description of all addresses, OpenAPI 3.1; schemas are made of the dataclasses that the answers are made of."""

from __future__ import annotations

import dataclasses
import re
import types
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from oysterbench.version import VERSION
from oysterbench_leaderboard.site.render import REPRESENTATIONS
from oysterbench_leaderboard.site.routes import FILES, PATTERNS, ROUTES, Route

PLAIN = {str: "string", int: "integer", float: "number", bool: "boolean", type(None): "null", dict: "object"}
ABOUT = {
    "track": "track of a board",
    "split": "data set, as pages spell it in addresses",
    "method": "method, as pages spell it in addresses",
    "board": "id of a board",
    "digest": "SHA-256 of a record, or its first 8 digits or more, which lead to the whole",
}


def describe(root: str = "", static: bool = False) -> dict[str, Any]:
    """The document. root: what a proxy puts before our addresses; static: of exported files, which answer no query."""
    schemas: dict[str, Any] = {
        "Error": {
            "type": "object",
            "properties": {"error": {"type": "string"}, "see": {"type": "object"}},
            "required": ["error"],
        }
    }
    paths: dict[str, Any] = {}
    for route in ROUTES:
        if static:
            route = replace(route, query=())
            if route.path == "/compare":
                continue
        bare = "/index" if route.path == "/" else route.path
        paths[route.path] = {"get": _operation(route, "", {"text/html": {"schema": {"type": "string"}}})}
        for suffix, (_, media) in REPRESENTATIONS.items():
            schema = _answer(route, schemas) if suffix == ".json" else {"type": "string"}
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
            "description": "Every page has other representations: its address with .json, .csv or .tex behind it.",
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
    refused = {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}
    responses = {
        "200": {"description": "as asked", "content": content},
        "304": {"description": "what the client has is still so"},
        "404": {"description": "nothing is there; what is", "content": refused},
    }
    if any(parameter["in"] == "query" for parameter in parameters):
        responses["400"] = {"description": "this cannot be asked, and why", "content": refused}
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


def _answer(route: Route, schemas: dict[str, Any]) -> dict[str, Any]:
    answers = {"path": str, "title": str, **route.answers}
    properties = {key: schema_of(kind, schemas) for key, kind in answers.items()}
    return {"type": "object", "properties": properties, "required": list(properties)}


def schema_of(kind: Any, schemas: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a type; dataclasses are put into `schemas` by their names."""
    if kind is Any:
        return {}
    if kind in PLAIN:
        return {"type": PLAIN[kind]}
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        if kind.__name__ not in schemas:
            hints = get_type_hints(kind)
            names = [field.name for field in dataclasses.fields(kind)]
            schemas[kind.__name__] = {}
            properties = {name: schema_of(hints[name], schemas) for name in names}
            schemas[kind.__name__] = {"type": "object", "properties": properties, "required": names}
        return {"$ref": f"#/components/schemas/{kind.__name__}"}
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"type": "string", "enum": list(inner)}
    if origin in (Union, types.UnionType):
        # A number that does not exist is null.
        return {"anyOf": [schema_of(one, schemas) for one in inner]}
    if origin is dict or (isinstance(origin, type) and issubclass(origin, Mapping)):
        return {"type": "object", "additionalProperties": schema_of(inner[1], schemas)}
    if origin in (list, tuple):
        return {"type": "array", "items": schema_of(inner[0], schemas)}
    raise TypeError(f"no schema of {kind!r}")
