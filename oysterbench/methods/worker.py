"""Runs a Python method in a process of its own, and leaves its predictions in a folder.

    python -m oysterbench.methods.worker REFERENCE INPUT FOLDER [SEED]

FOLDER receives the prediction files (see `interfaces`) and prediction.json: the fields of `Predicted`, with `wall_s`
and `cpu_s` of the method alone, threads and children included; or `failure`, one line.
"""

from __future__ import annotations

import json
import sys
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import OysterbenchError
from oysterbench.core.text import read_json
from oysterbench.methods.finding import find_method
from oysterbench.methods.interfaces import Predicted, Stopwatch, interface_of

PREDICTION = "prediction.json"


def predict(reference: str, given: Path, folder: Path, seed: int | None) -> dict[str, Any]:
    """Run the method on its input and write its predictions. Returns the content of prediction.json."""
    method = find_method(reference)
    if seed is not None:
        method.seed = seed  # type: ignore[attr-defined]
    watch = Stopwatch()
    try:
        found = interface_of(method.track).predict(method, given, folder, watch)
    except OysterbenchError as error:
        return {"failure": str(error)}
    except Exception as error:
        traceback.print_exc()
        line = " ".join(f"{type(error).__name__}: {error}".split())
        return {"failure": f"method {method.name!r} failed on {given.stem}: {line}"}
    found = replace(found, wall_s=watch.wall_s, cpu_s=watch.cpu_s)
    plain = {key: _plain(value) for key, value in vars(found).items()}
    return plain


def read_predicted(folder: Path) -> Predicted | str:
    """Read what a worker left in a folder, or why it failed. Raises OSError or ValueError where it did not finish."""
    held = read_json((folder / PREDICTION).read_bytes())
    if isinstance(held, dict) and "failure" in held:
        return str(held["failure"])
    return msgspec.convert(held, Predicted)


def _plain(value: Any) -> Any:
    """Convert a value for JSON; types that JSON does not know become strings."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return value if value is None or isinstance(value, str | bool | int | float) else str(value)


def main(reference: str, given: str, folder: str, seed: str = "") -> None:
    """Run the worker with the arguments of its command line."""
    result = predict(reference, Path(given), Path(folder), int(seed) if seed else None)
    write_atomically(Path(folder) / PREDICTION, json.dumps(result).encode())
    sys.exit(1 if "failure" in result else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
