"""Identity of a count: it is made once, and made anew if anything that it depends on has changed."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from oysterbench.methods.code import code_digests, file_digest
from oysterbench.methods.finding import versions_of
from oysterbench.methods.weights import weights_of
from oysterbench.version import VERSION

FORMAT = "oysterbench-count/3"


def method_identity(reference: str, method: object, options: Mapping[str, Any]) -> dict[str, Any]:
    """Everything about a method that its results depend on: reference, versions, its code (`methods.code`, or of an
    entry point the folder of its module), the weights that it declares (`methods.weights`), and every file that an
    option names."""
    files = {f"weights of {name}": path for name, path in weights_of(method).items()}
    files |= {f"file of {key}": Path(value) for key, value in options.items() if isinstance(value, str) and value}
    return {
        "method": reference,
        "versions": {"oysterbench": VERSION, **versions_of(reference)},
        "code": key_of(code) if (code := code_digests(reference)) else _code(type(method).__module__),
        "files": {what: file_digest(path) for what, path in files.items() if path.is_file()},
    }


def _code(module: str) -> str:
    """SHA-256 of the Python files of a module's package folder, or of the module's file if it is in no package."""
    found = sys.modules.get(module)
    file = getattr(found, "__file__", None)
    if file is None:
        return ""
    beside = sorted(Path(file).parent.glob("*.py")) if getattr(found, "__package__", "") else [Path(file)]
    return hashlib.sha256("".join(file_digest(path) for path in beside).encode()).hexdigest()


def key_of(values: Mapping[str, Any]) -> str:
    """SHA-256 of the values that a count depends on."""
    return hashlib.sha256(json.dumps({"format": FORMAT, **values}, sort_keys=True).encode()).hexdigest()
