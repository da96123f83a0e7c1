"""What a program prints while it runs: its progress, in lines `progress 120 of 700`, or else its last line."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from oysterbench.methods.processes import STDERR, STDOUT, complete_lines

PROGRESS = re.compile(r"progress (\d{1,9}) of (\d{1,9})")


@dataclass(frozen=True)
class RunOutput:
    """Latest output of a run in progress. done, total: of its last progress line, 0 if none; line: last other line."""

    done: int = 0
    total: int = 0
    line: str = ""


OnOutput = Callable[[Mapping[str, RunOutput]], None]
"""Called every second with the latest output of the running jobs, by their titles."""


def read_output(folder: Path) -> RunOutput:
    """Read the latest output of a run from the folder that its output goes to."""
    said = complete_lines(folder / STDOUT)
    steps = [match for line in said if (match := PROGRESS.fullmatch(line))]
    others = [line for line in said if not PROGRESS.fullmatch(line)] or complete_lines(folder / STDERR)
    done, total = map(int, steps[-1].groups()) if steps else (0, 0)
    return RunOutput(min(done, total), total, others[-1] if others else "")
