"""Checkpoints: the complete state of a training in one file, which is written atomically."""

from __future__ import annotations

import hashlib
import io
import platform
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MethodError
from oysterbench.core.names import did_you_mean, nearest
from oysterbench.core.text import in_one_line
from oysterbench.hub.verify import kept_card
from oysterbench.methods.weights import weights_names
from oysterbench.version import VERSION

FORMAT = "oysterbench-checkpoint/1"


@dataclass
class Checkpoint:
    """State of a training, finished or not.

    identity:  what determines the weights: settings, digests of the data, seed, threads, kind of device. A training
               resumes only from a checkpoint of the same identity
    network:   parameters from which the network is constructed
    weights, optimiser, random: their states after `step` steps; random: of torch's generators. The last two are empty
               once training is finished
    losses:    of each step; versions: of the software that computed them; seconds: CPU time so far
    measured:  measurements of the trained network, made after the last step; plain values and tensors
    """

    identity: dict[str, Any]
    network: dict[str, Any]
    weights: dict[str, Any]
    optimiser: dict[str, Any]
    random: dict[str, Any]
    step: int
    finished: bool
    losses: list[float]
    seconds: float
    versions: dict[str, str] = field(default_factory=dict)
    measured: dict[str, Any] = field(default_factory=dict)

    def write(self, path: Path) -> None:
        """Write as one file. It holds only tensors and plain values, so that reading it runs no code. The card of
        weights that were downloaded to this path is removed, as it does not describe these."""
        data = io.BytesIO()
        torch.save({"format": FORMAT, **asdict(self)}, data)
        write_atomically(path, data.getvalue())
        if kept_card(path) is not None:
            path.with_suffix(".json").unlink(missing_ok=True)

    def digest(self) -> str:
        """SHA-256 of the weights."""
        found = hashlib.sha256()
        for key, value in self.weights.items():
            found.update(key.encode() + value.contiguous().numpy().tobytes())
        return found.hexdigest()


def in_half_precision(weights: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Round the matrices of a state to float16, for a file of half the size. Vectors (biases, normalisation) are few
    and stay as they are. Loading a state into a network converts them back."""
    return {key: value.half() if value.dim() > 1 else value for key, value in weights.items()}


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint. Raises MethodError where the file is missing or is not a checkpoint of this version."""
    try:
        if damaged := _damaged_part(path):
            raise MethodError(
                f"{path}: damaged: {damaged} does not match its checksum; get the file again, or delete it and train "
                "again"
            )
        values = torch.load(path, map_location="cpu", weights_only=True)
        if not isinstance(values, dict) or values.pop("format", None) != FORMAT:
            raise ValueError(f"expected {FORMAT}")
        return Checkpoint(**values)
    except FileNotFoundError:
        names = weights_names()
        meant = "" if str(path) in names else did_you_mean(nearest(str(path), names))
        raise MethodError(f"{path}: no such checkpoint; {meant}`oysterbench train` makes one") from None
    except MethodError:
        raise
    except zipfile.BadZipFile:
        raise MethodError(
            f"{path}: not a checkpoint of this version, or cut short ({path.stat().st_size} bytes); get the file "
            "again, delete it and train again, or choose another file"
        ) from None
    except Exception as error:
        # torch raises any kind of exception from its unpickler where a file is damaged or not its own
        line = in_one_line(error)
        raise MethodError(f"{path}: not a checkpoint of this version ({line}); delete it and train again") from None


def read_finished(path: Path) -> Checkpoint:
    """Read the checkpoint of a training that has ended, its measurements included. Raises MethodError as
    `read_checkpoint` does, and where the training was interrupted."""
    checkpoint = read_checkpoint(path)
    unmeasured = checkpoint.identity.get("settings", {}).get("measured") and not checkpoint.measured
    if not checkpoint.finished or unmeasured:
        raise MethodError(
            f"{path}: the training is not finished, it has done {checkpoint.step} steps; the `oysterbench train` that "
            "began it resumes where it was left"
        )
    return checkpoint


def _damaged_part(path: Path) -> str:
    """Name of the first part of a checkpoint that is not as it was written; torch does not check them."""
    with zipfile.ZipFile(path) as archive:
        try:
            return archive.testzip() or ""
        except (EOFError, zlib.error):
            return "a part"


def versions() -> dict[str, str]:
    """Versions of the software on which the last bits of the weights depend."""
    return {
        "oysterbench": VERSION,
        "torch": str(torch.__version__),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
