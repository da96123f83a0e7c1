"""Submissions as the limited process opens them."""

from __future__ import annotations

import io
from pathlib import Path

import msgspec
import numpy as np

from oysterbench_leaderboard.submissions.archive import Limits
from oysterbench_leaderboard.submissions.catalogue import Wanted
from oysterbench_leaderboard.submissions.predictions import check_predictions, open_predictions

LIMITS = Limits(4_000_000, 1_000_000, 200, 20_000_000, 100.0)


def wanted_of(served, split: str, track: str = "slam") -> Wanted:
    made = served[split].wanted[track]
    assert msgspec.json.decode(msgspec.json.encode(made), type=Wanted) == made
    return made


def opened(tmp_path: Path, data: bytes, wanted: Wanted):
    file = tmp_path / "upload"
    file.write_bytes(data)
    predictions = open_predictions(file, wanted, LIMITS)
    return predictions, check_predictions(predictions, wanted)


def npz(**arrays) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()
