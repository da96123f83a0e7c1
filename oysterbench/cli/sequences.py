"""Sequences that are named on the command line: that they are there is seen before what reads them is loaded."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from oysterbench.core.errors import SequenceError


class SequencePath(click.Path):
    """The path of a sequence. Raises SequenceError where nothing is there."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Path:
        path = Path(os.fsdecode(super().convert(value, parameter, context)))
        if not path.exists():
            raise SequenceError(f"{path}: no such file; expected a sequence (.mcap) or an EuRoC folder")
        return path
