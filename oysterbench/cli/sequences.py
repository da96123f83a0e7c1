"""Sequences on the command line: their existence is checked before the code that reads them is loaded."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from oysterbench.core.errors import SequenceError


class SequencePath(click.Path):
    """Parameter type for the path of a sequence. Raises SequenceError where it does not exist."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Path:
        path = Path(os.fsdecode(super().convert(value, parameter, context)))
        if not path.exists():
            raise SequenceError(f"{path}: no such file; expected a sequence (.mcap) or an EuRoC folder")
        return path
