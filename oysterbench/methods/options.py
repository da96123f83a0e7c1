"""Variants of a method: `gtsam_vi[max_tracks=80,output=online]` is the method with options other than its defaults.

An option is a parameter of the method's class or, if its object has a dataclass `settings`, a field of that; a nested
field is written with a dot, as in `dead_reckoning[start.level_s=2]`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from oysterbench.core.errors import MethodError
from oysterbench.core.names import FEW, did_you_mean, nearest

VARIANT = re.compile(r"(?P<method>[^\[\]]+)\[(?P<options>.*)\]", re.DOTALL)
LONGEST = 80
"""Maximum length of a variant's name, which also names a folder and a record of a board; beyond it, the number and a
digest of the options stand for them."""
IN_QUOTES = 'commas separate options, and a value with a comma or bracket is written in double quotes, key="a,b"'
PLAIN, UNPLAIN = re.compile(r"[A-Za-z0-9_.+=-]+"), re.compile(r"[^A-Za-z0-9_.+=-]+")
"""Characters of an option's value that belong in a file name, and that do not."""


def split_variant(reference: str) -> tuple[str, dict[str, str]]:
    """Split a reference into the method and its options as written. Raises MethodError where an option is malformed.

    >>> split_variant("gtsam_vi[max_tracks=80,grid=[5,4]]")
    ('gtsam_vi', {'max_tracks': '80', 'grid': '[5,4]'})
    """
    found = VARIANT.fullmatch(reference)
    if found is None:
        return reference, {}
    words, ended = _parted(found["options"])
    if not ended:
        raise MethodError(f"options of {reference!r}: a bracket or quote does not end; {IN_QUOTES}")
    return found["method"], read_options(words)


def split_commas(text: str) -> list[str]:
    """Split a text at the commas that are not inside brackets or double quotes.

    >>> split_commas('grid=[5,4],mode="a,b"')
    ['grid=[5,4]', 'mode="a,b"']
    """
    return _parted(text)[0]


def _parted(text: str) -> tuple[list[str], bool]:
    """Split at commas as `split_commas`; and whether every bracket and quote ends."""
    parts, depth, quoted, escaped, before = [""], 0, False, False, "="
    for character in text:
        if quoted:
            quoted = escaped or character != '"'
            escaped = character == "\\" and not escaped
        elif character == '"' and before in "=,[{":  # within a word it is a letter like others
            quoted = True
        else:
            depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += character
        before = before if character == " " else character
    return parts, depth == 0 and not quoted


def as_word(value: str) -> str:
    """Write a text as the value of an option: in double quotes where commas, brackets or quotes could be misread."""
    parts, ended = _parted(value)
    return value if len(parts) == 1 and ended else json.dumps(value, ensure_ascii=False)


def read_options(words: Iterable[str]) -> dict[str, str]:
    """Read words `key=value` into key -> text. Raises MethodError for another form, or a repeated key."""
    options: dict[str, str] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise MethodError(f"option of a method: expected key=value, got {word!r}; {IN_QUOTES}")
        if key.strip() in options:
            raise MethodError(f"option of a method: {key.strip()!r} is given twice")
        options[key.strip()] = value.strip()
    return options


def with_options(reference: str, more: Iterable[str]) -> str:
    """Return the reference with more options, each `key=value`; they replace options with the same key.

    >>> with_options("gtsam_vi[output=online]", ["max_tracks=80"])
    'gtsam_vi[output=online,max_tracks=80]'
    """
    method, options = split_variant(reference)
    given = read_options(more)
    options |= {key: value if _parted(value)[1] else as_word(value) for key, value in given.items()}
    return f"{method}[{','.join(f'{key}={value}' for key, value in options.items())}]" if options else method


def _in_name(value: str) -> str:
    """Write a value so that it can be part of a file name: a list without its brackets, and what cannot be written as
    it is with a digest.

    >>> [_in_name("-0.5"), _in_name("[-1, 2]"), _in_name("a/b")]
    ['-0.5', '-1-2', 'a-b-c14cddc0']
    """
    items = value[1:-1].split(",") if value.startswith("[") and value.endswith("]") else [value]
    items = [item.strip() for item in items]
    if all(PLAIN.fullmatch(item) for item in items):
        return "-".join(items)
    return f"{UNPLAIN.sub('-', value).strip('-')}-{hashlib.sha256(value.encode()).hexdigest()[:8]}".lstrip("-")


def variant_name(name: str, options: Mapping[str, str]) -> str:
    """Name of a variant, used in tables and for its folder: the name of the method followed by its options. Options
    that differ give names that differ, but for a list and a text that is written like it.

    >>> variant_name("gtsam_vi", {"grid": "[5, 4]"})
    'gtsam_vi[grid=5-4]'
    """
    if not options:
        return name
    written = ",".join(f"{key}={_in_name(value)}" for key, value in options.items())
    if len(f"{name}[{written}]") > LONGEST:
        written = f"{len(options)}-options-{hashlib.sha256(written.encode()).hexdigest()[:8]}"
    return f"{name[: LONGEST - len(written) - len('[]')]}[{written}]"


def configure(kind: Callable[..., Any], options: Mapping[str, str], reference: str) -> tuple[Any, dict[str, Any]]:
    """Create an object of a method's class with options. Returns it and the options' values.

    Raises MethodError where the method has no such option, or a value has the wrong type.
    """
    method = kind()
    if not options:
        return method, {}
    settings = getattr(method, "settings", None)
    if not dataclasses.is_dataclass(settings) or isinstance(settings, type):
        settings = None
    parameters = {
        key: parameter.default
        for key, parameter in inspect.signature(kind).parameters.items()
        if key != "settings" and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
    }
    known = {**parameters, **(fields_of(settings) if settings is not None else {}), **parameters}
    arguments: dict[str, Any] = {}
    values: dict[str, Any] = {}
    for key, text in options.items():
        if key not in known:
            instead = _instead(key, list(known), parameters, settings)
            raise MethodError(f"method {reference!r} has no option {key!r}; {instead}")
        values[key] = read_value(text, known[key], f"option {key!r} of method {reference!r}")
        if key in parameters:
            arguments[key] = values[key]
        else:
            settings = replaced(settings, key.split("."), values[key])
    if len(arguments) < len(values):
        arguments["settings"] = settings
    return kind(**arguments), values


def _instead(key: str, known: list[str], parameters: Iterable[str], settings: Any) -> str:
    """Advice for an unknown option: all options, or, if there are many, similar ones and where to find the rest."""
    renamed: Mapping[str, str] = getattr(settings, "renamed", {})  # former names of its options
    if key in renamed:
        return f"it is called {renamed[key]!r} now"
    if len(known) <= FEW:
        return f"its options: {', '.join(known)}" if known else "it has none"
    # A nested option is also matched by its last name alone: level_s for start.level_s.
    by_name = {name.rpartition(".")[2]: name for name in known} | {name: name for name in known}
    meant = did_you_mean(dict.fromkeys(by_name[name] for name in nearest(key, by_name)))
    all_of_them = ", ".join(parameters)
    if settings is not None:
        all_of_them += f" and the fields of {type(settings).__module__}.{type(settings).__qualname__}"
    return f"{meant}{'Its' if meant else 'its'} {len(known)} options are {all_of_them.removeprefix(' and ')}"


def fields_of(settings: Any, prefix: str = "") -> dict[str, Any]:
    """Field -> value of a dataclass object; names of nested fields are joined by dots."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            found |= fields_of(value, f"{prefix}{field.name}.")
        else:
            found[f"{prefix}{field.name}"] = value
    return found


def replaced(settings: Any, path: list[str], value: Any) -> Any:
    """Copy a dataclass object, with another value at a path of fields."""
    first, *rest = path
    return dataclasses.replace(settings, **{first: replaced(getattr(settings, first), rest, value) if rest else value})


def read_value(text: str, default: Any, what: str) -> Any:
    """Read a value in TOML, where bare words are strings, as the type of the default; as any type without a default."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    if default is None or default is inspect.Parameter.empty:
        return value
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(default, tuple) and isinstance(value, list):
        value = tuple(value)
        item = default[0] if default else None
        if isinstance(item, float):
            value = tuple(float(each) if type(each) is int else each for each in value)
        if item is None or all(type(each) is type(item) for each in value):
            return value
    elif isinstance(default, str) and not isinstance(value, str):
        return text  # a word that happens to be a number
    elif type(value) is type(default):
        return value
    raise MethodError(f"{what}: expected {_expected(default)}, such as {_written(default)}, got {text!r}")


def _expected(default: Any) -> str:
    kinds: dict[type, str] = {bool: "true or false", int: "a whole number", float: "a number", tuple: "a list"}
    return kinds.get(type(default), f"a value of type {type(default).__name__}")


def _written(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{','.join(map(_written, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)
