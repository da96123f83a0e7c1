"""Command lines of helper processes: modules of this project, run by Python."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def module_command(module: str, *arguments: str | Path, python: str | Path = sys.executable) -> list[str]:
    """Command line by which an interpreter runs a module with arguments.

    What this process imports from its installed packages, the other does not find first in the working folder, which
    Python puts before all other places with -m. An empty path, as in a notebook, is the working folder.
    """
    here = os.path.realpath(os.curdir)
    from_here = "" in sys.path or (bool(sys.path) and os.path.realpath(sys.path[0]) == here)
    return [str(python), *([] if from_here else ["-P"]), "-m", module, *map(str, arguments)]
