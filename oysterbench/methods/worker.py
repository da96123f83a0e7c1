"""Runs a method of Python in a process of its own, and leaves its answer in a folder.

    python -m oysterbench.methods.worker REFERENCE SEQUENCE FOLDER [SEED]

FOLDER gets estimate.npz, the path that is scored; estimate.NAME.npz of each alternative; map.ply and keyframes.tum
where there is a map; and answer.json: `info`, `scored`, `alternatives` (names) and `map` (counts, or null) of the
estimate, and `wall_s` and `cpu_s` of `run` alone, threads and children included; or `failure`, one line, where there is
no estimate.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.files import write_atomically
from oysterbench.core.trajectory import write_npz
from oysterbench.methods.finding import find_method
from oysterbench.methods.method import Estimate
from oysterbench.sequence import open_sequence

ANSWER, ESTIMATE = "answer.json", "estimate.npz"


def answer(reference: str, path: str, folder: Path, seed: int | None) -> dict[str, Any]:
    """Run the method on the sensors of the sequence at `path`, write its estimate; returns what answer.json says."""
    method = find_method(reference)
    if seed is not None:
        method.seed = seed  # type: ignore[attr-defined]
    sequence = open_sequence(path).for_method()
    wall, cpu = time.perf_counter(), _cpu_s()
    try:
        estimate = method.run(sequence)
        cost = {"wall_s": time.perf_counter() - wall, "cpu_s": _cpu_s() - cpu}
        return {**keep(estimate, folder), **cost}
    except OysterbenchError as error:
        return {"failure": str(error)}
    except Exception as error:
        traceback.print_exc()
        line = " ".join(f"{type(error).__name__}: {error}".split())
        return {"failure": f"method {method.name!r} failed on sequence {sequence.name}: {line}"}


def keep(estimate: Estimate, folder: Path) -> dict[str, Any]:
    """Write an estimate; returns what answer.json says of it."""
    write_npz(folder / ESTIMATE, estimate.trajectory)
    for name, path in estimate.alternatives.items():
        write_npz(folder / alternative_file(name), path)
    counts = None
    if estimate.map is not None:
        estimate.map.write(folder)
        counts = {"keyframes": len(estimate.map.keyframes), "landmarks": len(estimate.map.landmarks)}
    return {
        "info": _plain(dict(estimate.info)),
        "scored": estimate.scored,
        "alternatives": list(estimate.alternatives),
        "map": counts,
    }


def alternative_file(name: str) -> str:
    """File of an alternative in the folder of its run."""
    return f"estimate.{name}.npz"


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _plain(value: Any) -> Any:
    """Values that JSON knows; what it does not know, as text."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return value if value is None or isinstance(value, str | bool | int | float) else str(value)


def main(reference: str, path: str, folder: str, seed: str = "") -> None:
    """As the command line has it."""
    result = answer(reference, path, Path(folder), int(seed) if seed else None)
    write_atomically(Path(folder) / ANSWER, json.dumps(result).encode())
    sys.exit(1 if "failure" in result else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
