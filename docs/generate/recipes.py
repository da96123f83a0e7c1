"""Pages of all keys of a recipe and of a rig, from the dataclasses that read them."""

from __future__ import annotations

import dataclasses
import inspect
import types
import typing
from collections.abc import Iterator
from typing import Any

from docs.generate.fields import Told, told_fields
from docs.generate.markdown import code, table
from oysterbench.recipe.keys import Table

LISTS = {"sequence", "drawn", "camera", "lamp"}
"""Keys that are lists of tables, `[[key]]`."""

NOT_WRITTEN = {"source", "rig_source", "sensors"}
"""Fields that no key of a file fills."""

RECIPE_HEAD = """# Recipe keys

A split is a TOML file; these are its tables and their keys, with type, allowed values and default. A required key
has no default. Each value is checked: an invalid one is refused with file, key, value and what is allowed.

A table `[defaults]` holds what the sequences share; each `[[sequence]]` states only what differs, key by key.
`rig = "NAME"` names the rig: a file in `datasets/rigs/` or, with `.toml`, a path relative to the recipe
([its keys](rig.md)).
"""

RIG_HEAD = """# Rig keys

A rig is a TOML file: a vehicle and its sensors. Each sensor is a table named after its kind; several of a kind are
written as `[[block]]`.
"""


def recipe_page() -> str:
    """The page of the keys of a split's file."""
    from oysterbench.recipe import SplitRecipe

    return RECIPE_HEAD + "".join(_sections(SplitRecipe, ""))


def rig_page() -> str:
    """The page of the keys of a rig's file."""
    from oysterbench.recipe import LampRecipe, RigRecipe
    from oysterbench.sensors.registry import sensor_kinds

    pages = [_section(RigRecipe, ""), _section(LampRecipe, "lamp", many=True)]
    for block, kind in sensor_kinds().items():
        pages.append(_section(kind.recipe, block, many=not kind.single))
    return RIG_HEAD + "".join(pages)


def recipe_tables(kind: type, prefix: str = "") -> Iterator[tuple[str, type]]:
    """Name of each table of a split file, and the dataclass that reads it; without the rig."""
    yield prefix, kind
    for told in told_fields(kind):
        inner = _table_of(typing.get_type_hints(kind)[told.field.name])
        if inner is not None and told.field.name != "rig":
            yield from recipe_tables(inner, f"{prefix}.{told.field.name}".lstrip("."))


def _sections(kind: type, prefix: str) -> Iterator[str]:
    for name, each in recipe_tables(kind, prefix):
        yield _section(each, name, many=name.rpartition(".")[2] in LISTS)


def _section(kind: type, name: str, many: bool = False) -> str:
    heading = "The file itself" if not name else f"`[[{name}]]`" if many else f"`[{name}]`"
    anchor = name.replace(".", "-").replace("_", "-") or "file"
    hints = typing.get_type_hints(kind)
    rows = [_row(told, hints[told.field.name]) for told in told_fields(kind) if told.field.name not in NOT_WRITTEN]
    about = inspect.cleandoc(kind.__doc__ or "")
    keys = table(("Key", "Type", "Allowed", "Default", "Meaning"), rows)
    return f"\n## {heading} {{ #{anchor} }}\n\n{about}\n\n{keys}"


def _row(told: Told, hint: Any) -> tuple[str, ...]:
    field = told.field
    return code(field.name), _type(hint), _allowed(field), _default(field, hint), told.text


def _bare(hint: Any) -> Any:
    """Type without the None of an optional field."""
    if isinstance(hint, types.UnionType):
        return next(kind for kind in typing.get_args(hint) if kind is not type(None))
    return hint


def _table_of(hint: Any) -> type | None:
    """Dataclass of a table, or of the tables of a list; None for other types."""
    hint = _bare(hint)
    if typing.get_origin(hint) is tuple:
        hint = typing.get_args(hint)[0]
    return typing.cast(type, hint) if dataclasses.is_dataclass(hint) else None


def _type(hint: Any) -> str:
    hint = _bare(hint)
    if typing.get_origin(hint) is tuple:
        inner = typing.get_args(hint)
        if inner[-1] is Ellipsis:
            return f"list of {_plural(inner[0])}"
        return f"{len(inner)} {_plural(inner[0])}"
    if hint is Table or dataclasses.is_dataclass(hint):
        return "table"
    return {str: "text", bool: "true, false", int: "whole number", float: "number"}.get(hint, "list")


def _plural(hint: Any) -> str:
    if dataclasses.is_dataclass(hint):
        return "tables"
    return {str: "texts", int: "whole numbers", float: "numbers"}.get(hint, "lists of numbers")


def _allowed(field: dataclasses.Field[Any]) -> str:
    if "range" in field.metadata:
        low, high = field.metadata["range"]
        return " to ".join(str(end) if isinstance(end, int) else f"{end:g}" for end in (low, high))
    return ", ".join(map(code, field.metadata.get("options", ())))


def _default(field: dataclasses.Field[Any], hint: Any) -> str:
    if field.default is dataclasses.MISSING:
        return "required"
    if field.default in (None, "") or _table_of(hint) is not None or isinstance(field.default, Table):
        return ""
    if isinstance(field.default, bool):
        return code(str(field.default).lower())
    if isinstance(field.default, tuple):
        return code(list(field.default))
    return code(f"{field.default:g}" if isinstance(field.default, float) else field.default)
