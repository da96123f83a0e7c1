"""Where things are that tests read or run."""

from __future__ import annotations

import os
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
"""The checkout."""

DATASETS, BASELINES = ROOT / "datasets", ROOT / "baselines"
HELPERS = Path(__file__).parent

COMMAND = Path(sys.executable).with_name("oysterbench")


SHARED_DATA = Path(os.environ.get("OYSTERBENCH_SHARED_DATA", ROOT.parent / "shared" / "data"))
"""Data that is not part of the project; tests that need it skip where it is absent."""
