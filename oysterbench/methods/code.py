"""The code of a method given as `module:Class`: the Python files by whose content it is known."""

from __future__ import annotations

import ast
import hashlib
import os
import sys
import warnings
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from oysterbench.methods.options import split_variant

INSTALLED = ("site-packages", "dist-packages")
"""Folders of installed packages, beside which lie others that have nothing to do with a method."""
OWN = "oysterbench"
"""Known by its version, also where a method's file is beside its source."""


def file_digest(path: Path) -> str:
    """SHA-256 of a file, or of the Python files of a package; of a file cached until its size or time changes."""
    if path.is_dir():
        digests = [f"{each.relative_to(path)} {file_digest(each)}" for each in sorted(_sources(path))]
        return hashlib.sha256("\n".join(digests).encode(errors="surrogateescape")).hexdigest()
    state = path.stat()
    return _file_digest(path.absolute(), state.st_size, state.st_mtime_ns)


@cache
def _file_digest(path: Path, size: int, modified_ns: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def code_digests(reference: str) -> dict[str, str]:
    """SHA-256 of the files of a method `module:Class`, by path from the folder on Python's path that holds its module;
    empty for an entry point, which is known by the version of its package.

    They are all Python files of its package, or, for a module in no package, that file and what it imports from the
    same folder, directly or not. Files that it reads itself, such as weights, are not among them.
    """
    module, colon, _ = split_variant(reference)[0].partition(":")
    if not colon:
        return {}
    search_here()
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):  # ValueError: a module that was made without a file
        spec = None
    if spec is None or not spec.has_location or not spec.origin:
        return {}
    file = Path(spec.origin).absolute()
    if not file.is_file():  # in a zip archive, which is known as a whole
        return {each.name: file_digest(each) for each in file.parents if each.is_file()}
    levels = module.count(".") + (file.stem == "__init__")
    root = file.parents[levels]
    files = _files(root, module) or set(_beside(file))
    return {path.relative_to(root).as_posix(): file_digest(path) for path in sorted(files)}


def search_here() -> None:
    """Let modules be found in the working folder, after all other places."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def _beside(file: Path) -> list[Path]:
    """Files of the folder of a package whose name is not that of the folder; the file itself if it is in none."""
    return list(_sources(file.parent)) if (file.parent / "__init__.py").is_file() else [file]


def _sources(package: Path) -> Iterator[Path]:
    """Python files of a package. Folders that Python cannot import from are not entered: `.ipynb_checkpoints`, and the
    libraries of a virtual environment. Hidden files and broken links, such as the locks of editors, are left out."""
    for place, folders, names in os.walk(package):
        folders[:] = [name for name in folders if name.isidentifier() and name != "__pycache__"]
        for name in names:
            if name.endswith(".py") and not name.startswith(".") and os.path.isfile(os.path.join(place, name)):
                yield Path(place, name)


def _files(root: Path, module: str) -> set[Path]:
    alone = not (root / module.partition(".")[0] / "__init__.py").is_file()  # else its package is all that is asked for
    found, names, waiting = set[Path](), {module}, [module]
    while waiting:
        place = _place(root, waiting.pop())
        if place is None or place in found:
            continue
        files = set(_sources(place)) if place.is_dir() else {place}
        found |= {place, *files}
        for path in files if alone and root.name not in INSTALLED else ():
            package = path.parent.relative_to(root).parts
            new = _imported(path, ".".join(package), path.stat().st_mtime_ns) - names
            names |= new
            waiting += [name for name in new if name.partition(".")[0] != OWN]
    return {path for path in found if not path.is_dir()}


def _place(root: Path, module: str) -> Path | None:
    """Where a module is in a folder: the folder of its package, or the file that it is; None if it is elsewhere."""
    place = root
    for part in module.split("."):
        file, place = place / f"{part}.py", place / part
        if (place / "__init__.py").is_file():
            return place
        if file.is_file():
            return file
    return None


@cache
def _imported(path: Path, package: str, modified_ns: int) -> frozenset[str]:
    """Names that a file imports, wherever in it, each as if it were a module. package: that relative ones start from"""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they are given when it is imported
            tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):
        return frozenset()
    return frozenset(_names(tree, package.split(".") if package else []))


def _names(tree: ast.AST, package: list[str]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) + 1 - node.level] if node.level else []
            module = [*start, *([node.module] if node.module else [])]
            yield from (".".join([*module, each.name]) for each in node.names)
