"""Store of finished rollouts: one file each, written atomically, and named after everything that determines it."""

from __future__ import annotations

import hashlib
import inspect
import io
import json
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.evaluate.steering import RolloutLog
from oysterbench.methods.code import code_digests, file_digest
from oysterbench.methods.finding import find_method, versions_of
from oysterbench.methods.options import split_variant
from oysterbench.methods.weights import weights_digests, weights_of

FORMAT = "oysterbench-rollout/1"
ARRAYS = ("states", "altitude", "commands", "seen", "contact", "turned", "covered", "oysters", "found")


def packed(log: RolloutLog) -> bytes:
    """Pack a rollout as .npz."""
    plain = {f.name: getattr(log, f.name) for f in fields(RolloutLog) if f.name not in ARRAYS}
    stream = io.BytesIO()
    head = np.array(json.dumps({"format": FORMAT, **plain}))
    np.savez_compressed(stream, head=head, **{key: getattr(log, key) for key in ARRAYS})
    return stream.getvalue()


def unpacked(data: bytes, where: str = "rollout") -> RolloutLog:
    """Unpack a rollout from the data of `packed`. Raises ResultError naming `where`."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            head = json.loads(str(held["head"]))
            if head.pop("format") != FORMAT:
                raise ValueError(f"expected {FORMAT}")
            return RolloutLog(**head, **{key: held[key] for key in ARRAYS})
    except Exception as error:  # numpy, zipfile and json each have their own errors
        raise ResultError(
            f"{where}: not a rollout in this version's format ({type(error).__name__}: {error}); delete it, or redo it "
            "with --again"
        ) from None


def rollout_file(folder: Path, reef: str, policy: str, identity: Mapping[str, Any]) -> Path:
    """File of a rollout. identity: JSON values, everything that determines the rollout."""
    text = json.dumps(identity, sort_keys=True, default=str)
    safe = "".join(sign if sign.isalnum() or sign in "_.-" else "_" for sign in policy)
    return folder / f"{reef}-{safe}-{hashlib.sha256(text.encode()).hexdigest()[:12]}.npz"


def method_identity(reference: str) -> dict[str, Any]:
    """Identity of a method, as far as it determines how it steers: settings, seed, package versions, its code
    (`methods.code`, or of an entry point the text of the file that defines its class), its trained weights, and the
    files that its options name."""
    method = find_method(reference)
    try:
        source = Path(inspect.getfile(type(method))).read_bytes()
    except (OSError, TypeError):  # not defined in a file
        source = b""
    weights = weights_digests(weights_of(method))
    named = {key: Path(value) for key, value in split_variant(reference)[1].items() if value}
    files = {key: file_digest(path) for key, path in named.items() if path.is_file()}
    return {
        "reference": reference,
        "settings": {**getattr(method, "as_dict", dict)(), **({"weights": weights} if weights else {})},
        "seed": getattr(method, "seed", None),
        **({"files": files} if files else {}),
        "versions": versions_of(reference),
        "source": code_digests(reference) or hashlib.sha256(source).hexdigest(),
    }


@cache
def steering_source() -> str:
    """SHA-256 of the source code that determines a rollout: the vehicle, what it sees, the expert, the references."""
    whole = hashlib.sha256()
    for room in ("simulation/steering", "exploration"):
        folder = resources.files("oysterbench").joinpath(room)
        for file in sorted((f for f in folder.iterdir() if f.name.endswith(".py")), key=lambda file: file.name):
            whole.update(file.read_bytes())
    return whole.hexdigest()


def read_rollout(path: Path) -> RolloutLog | None:
    """Read the rollout in a file; None if there is no file yet."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise OysterbenchError(f"{path}: cannot be read: {error.strerror or error}") from None
    return unpacked(data, str(path))
