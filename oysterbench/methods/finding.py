"""Finding a method by the name of an entry point, or as `module:Class`."""

from __future__ import annotations

import re
import sys
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from oysterbench.core.errors import MethodError
from oysterbench.core.names import did_you_mean, nearest
from oysterbench.methods.code import search_here
from oysterbench.methods.method import Method
from oysterbench.methods.options import configure, split_variant, variant_name

ENTRY_POINTS = "oysterbench.methods"


def method_names(track: str | None = None) -> list[str]:
    """Names of the installed methods, optionally only of one track."""
    names = sorted(_points())
    return names if track is None else [name for name in names if find_method(name).track == track]


def find_method(reference: str) -> Method:
    """Create a new object of an installed method, by name, or of a class `module:Class`, with options in brackets.

    A module is searched for on Python's path and in the working folder. For the brackets see `options`; they become
    part of the method's name. Raises MethodError where the method cannot be found or loaded.
    """
    return find_variant(reference)[0]


def find_variant(reference: str) -> tuple[Method, dict[str, Any]]:
    """Find a method as `find_method` does. Returns it and the values of its options."""
    reference, options = split_variant(reference)
    try:
        kind = _load_class(reference) if ":" in reference else _load_point(reference)
        method, values = configure(kind, options, reference)
    except MethodError:
        raise
    except ImportError as error:
        raise MethodError(f"method {reference!r} cannot be loaded: {error}{_advice(reference, error)}") from None
    except Exception as error:
        raise MethodError(f"method {reference!r} cannot be loaded: {type(error).__name__}: {error}") from error
    if isinstance(method, type) or not isinstance(method, Method):
        raise MethodError(f"method {reference!r}: expected an object with name, track and run, got {type(method)}")
    if options:
        method.name = variant_name(method.name, options)
    return method, values


def versions_of(reference: str) -> dict[str, str]:
    """Name and version of the package that an entry point comes from; empty for a class."""
    point = _points().get(split_variant(reference)[0])
    return {} if point is None or point.dist is None else {point.dist.name: point.dist.version}


def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)}


def _load_point(name: str) -> Any:
    points = _points()
    if name not in points:
        from oysterbench.methods.systems import systems  # which imports this module

        published = (method for system in systems().values() for method in system.description.methods)
        meant = did_you_mean(nearest(name, [*points, *published]))
        raise MethodError(
            f"unknown method {name!r}; {meant}installed methods: {', '.join(sorted(points)) or 'none'}; give a class "
            "as module:Class, any other program with `oysterbench run --command`; `oysterbench systems` lists "
            "published systems"
        )
    return points[name].load()


def _advice(reference: str, error: ImportError) -> str:
    """What to do about a method that could not be imported."""
    module, of_class, name = reference.partition(":")
    if not of_class:
        return "; install what it needs, e.g. pip install 'oysterbench[slam]'"
    if module.endswith(".py"):
        return f"; expected a module, not its file: did you mean {Path(module).stem}:{name}?"
    if error.name == module:
        return f"; it was searched for on Python's path and in {Path.cwd()}"
    return ""


def _load_class(reference: str) -> Any:
    module, _, name = reference.partition(":")
    if not module or not name:
        raise MethodError(f"method {reference!r}: expected module:Class, such as my_slam:MySlam")
    search_here()
    _check_mentioned(reference, module, name)
    found = import_module(module)
    if not hasattr(found, name):
        raise MethodError(f"method {reference!r}: {found.__file__} has no {name!r}")
    return getattr(found, name)


def _check_mentioned(reference: str, module: str, name: str) -> None:
    """Refuse a class whose name does not occur in its module's source, before importing it: its own imports, such as
    PyTorch, can take seconds. Modules that may get names from elsewhere are left to the import."""
    spec = None if module in sys.modules else find_spec(module)
    file = Path((spec.origin if spec else None) or "")
    if file.suffix != ".py" or not file.is_file():  # such as a module in a zip archive
        return
    source = file.read_text(encoding="utf-8", errors="replace")
    if not re.search(rf"\b{re.escape(name)}\b|import \*|__getattr__|globals\(|setattr\(|exec\(", source):
        classes = re.findall(r"^class (\w+)", source, re.MULTILINE)
        meant = did_you_mean(nearest(name, classes))
        raise MethodError(
            f"method {reference!r}: {file} has no {name!r}; {meant}its classes: {', '.join(classes) or 'none'}"
        )
