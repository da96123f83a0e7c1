"""Keys of a recipe: fields of frozen dataclasses that carry their allowed values, and their parsing from TOML."""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Any, TypeVar

from oysterbench.core.errors import RecipeError
from oysterbench.core.names import did_you_mean, nearest

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Kind = TypeVar("Kind", bound="DataclassInstance")


class Table(Mapping[str, Any]):
    """A table of a recipe that is kept as written and checked where it is used: like a dict, but hashable."""

    def __init__(self, items: Mapping[str, Any] | None = None) -> None:
        self._items = {key: _frozen(value) for key, value in (items or {}).items()}

    def __getitem__(self, key: str) -> Any:
        return self._items[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __hash__(self) -> int:
        return hash(frozenset(self._items.items()))

    def __repr__(self) -> str:
        return repr(as_plain(self))


def _frozen(value: Any) -> Any:
    if isinstance(value, Mapping):
        return Table(value)
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value


def number(low: float, high: float, default: Any = dataclasses.MISSING) -> Any:
    """A numeric key with its allowed range, both ends included."""
    return field(default=default, metadata={"range": (low, high)})


def choice(options: tuple[str, ...], default: Any = dataclasses.MISSING) -> Any:
    """A text key with its allowed values."""
    return field(default=default, metadata={"options": options})


def build(kind: type[Kind], table: Any, where: str, prefix: str) -> Kind:
    """Build the dataclass `kind` from a TOML table, key by key. prefix: of the keys in messages.

    Raises RecipeError, which starts with `where`, for unknown and missing keys and for bad values.
    """
    if not isinstance(table, Mapping):
        raise RecipeError(f"{where}: key {prefix[:-1]!r}: expected a table, got {_shown(table)}")
    hints = _hints(kind)
    fields = {f.name: f for f in dataclasses.fields(kind)}
    for key in table:
        if key not in fields:
            known = _documented(fields)
            meant = did_you_mean(nearest(key, known))
            raise RecipeError(f"{where}: unknown key {prefix + key!r}; {meant}known keys here: {', '.join(known)}")
    values = {}
    for name, definition in fields.items():
        if name in table:
            values[name] = _convert(table[name], hints[name], definition, where, prefix + name)
        elif definition.default is dataclasses.MISSING:
            raise RecipeError(f"{where}: missing key {prefix + name!r}{_allowed(definition)}")
    return kind(**values)


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    """Types of a dataclass's fields, resolved only once: a split has hundreds of tables of a few kinds."""
    return typing.get_type_hints(kind)


def _convert(value: Any, hint: Any, definition: dataclasses.Field[Any], where: str, key: str) -> Any:
    """Convert one value, checked against its type and range."""
    if isinstance(hint, types.UnionType):  # an optional key
        if value is None:
            return None
        hint = next(kind for kind in typing.get_args(hint) if kind is not type(None))
    if hint is Table:
        if not isinstance(value, Mapping):
            raise RecipeError(f"{where}: key {key!r}: expected a table, got {value!r}")
        return Table(value)
    if dataclasses.is_dataclass(hint):
        kind = typing.cast(type, hint)
        return value if isinstance(value, kind) else build(kind, value, where, f"{key}.")
    if typing.get_origin(hint) is tuple:
        inner = typing.get_args(hint)
        if not isinstance(value, list):
            of_tables = f" of tables, [[{key}]]" if dataclasses.is_dataclass(inner[0]) else ""
            raise RecipeError(f"{where}: key {key!r}: expected a list{of_tables}, got {_shown(value)}")
        if len(inner) == 2 and inner[1] is Ellipsis:
            return tuple(_convert(item, inner[0], definition, where, key) for item in value)
        if len(value) != len(inner):
            raise RecipeError(f"{where}: key {key!r}: expected {len(inner)} numbers, got {value!r}")
        return tuple(_convert(v, t, definition, where, key) for v, t in zip(value, inner, strict=True))
    if hint is str:
        options = definition.metadata.get("options")
        if not isinstance(value, str) or (options and value not in options):
            raise RecipeError(f"{where}: key {key!r}: expected {_text(options)}, got {value!r}")
        return value
    if hint is bool:
        if not isinstance(value, bool):
            raise RecipeError(f"{where}: key {key!r}: expected true or false, got {value!r}")
        return value
    if isinstance(value, bool) or not isinstance(value, int if hint is int else (int, float)):
        wanted = "a whole number" if hint is int else "a number"
        raise RecipeError(f"{where}: key {key!r}: expected {wanted}{_allowed(definition)}, got {value!r}")
    low, high = definition.metadata.get("range", (-math.inf, math.inf))
    if not low <= value <= high:
        raise RecipeError(f"{where}: key {key!r}: expected {low:g} to {high:g}, got {value!r}")
    return hint(value)


def _shown(value: Any) -> str:
    """A value in a message; of a table only that it is one, as it may be a whole file."""
    return "one table" if isinstance(value, Mapping) else f"{value!r:.120}"


def _documented(fields: Mapping[str, Any]) -> list[str]:
    return [name for name in fields if name not in ("source", "rig_source")]


def _allowed(definition: dataclasses.Field[Any]) -> str:
    if "range" in definition.metadata:
        low, high = definition.metadata["range"]
        return f" from {low:g} to {high:g}"
    if "options" in definition.metadata:
        return f" ({_text(definition.metadata['options'])})"
    return ""


def _text(options: tuple[str, ...] | None) -> str:
    return "one of " + ", ".join(options) if options else "text"


def stated(value: Any) -> Any:
    """A recipe as nested dicts and lists, without the keys that have their default values.

    So a key that is added later, with a default that changes nothing, does not alter what older recipes state.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        defaults = {f.name: f.default for f in dataclasses.fields(value)}
        given = {k: v for k, v in _tables(value).items() if k not in defaults or v != defaults[k]}
        return {key: stated(item) for key, item in given.items()}
    if isinstance(value, tuple):
        return [stated(item) for item in value]
    return as_plain(value)


def _tables(value: Any) -> dict[str, Any]:
    """Keys and values of a recipe, as in its file."""
    if hasattr(value, "as_tables"):
        tables: dict[str, Any] = value.as_tables()
        return tables
    return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}


def as_plain(value: Any) -> Any:
    """A recipe as nested dicts and lists, for JSON; values that are not given (None) are left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        values = {key: as_plain(item) for key, item in _tables(value).items()}
        return {name: item for name, item in values.items() if item is not None}
    if isinstance(value, tuple | list):
        return [as_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: as_plain(item) for key, item in value.items()}
    return value
