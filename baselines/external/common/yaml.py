"""Texts in OpenCV's dialect of YAML, which YAML's own writers do not write and whose comments they would drop."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array


def replace_values(text: str, values: Mapping[str, Any]) -> str:
    """A text of flat `key: value` lines with other values; comments stay. Raises MethodError for a key it lacks."""
    for key, value in values.items():
        found = re.findall(rf"^{re.escape(key)}:[ \t]*(\"[^\"]*\"|[^#\s]+)", text, re.M)
        if len(found) != 1:
            raise MethodError(f"the authors' configuration has {len(found)} keys {key!r}; expected 1")
        before = re.escape(found[0])
        text = re.sub(
            rf"^({re.escape(key)}:[ \t]*){before}", rf"\g<1>{plain(value, '.' in found[0])}", text, flags=re.M
        )
    return text


def plain(value: Any, real: bool = True) -> str:
    """A value as OpenCV reads it, which tells 460 from 460.0. real: whether a whole number gets a point"""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    return str(int(value)) if value == int(value) and not (real or isinstance(value, float)) else repr(float(value))


def matrix(values: Array) -> list[str]:
    """Lines of a matrix as Kalibr writes it, two spaces under its key."""
    return [f"    - [{', '.join(repr(float(value)) for value in row)}]" for row in np.asarray(values)]


def opencv_matrix(values: Array) -> list[str]:
    """Lines of a matrix of reals as OpenCV writes it, under a key that ends in `!!opencv-matrix`."""
    rows, cols = values.shape
    numbers = ", ".join(repr(float(value)) for value in np.ravel(values))
    return [f"  rows: {rows}", f"  cols: {cols}", "  dt: f", f"  data: [{numbers}]"]


def replace_block(text: str, key: str, lines: list[str]) -> str:
    """A text with other lines under a key: all that are indented. Raises MethodError for a key it lacks."""
    found = re.search(rf"^{re.escape(key)}:.*\n((?:[ \t]+.*\n)+)", text, re.M)
    if found is None:
        raise MethodError(f"the authors' configuration has no block {key!r}")
    return text[: found.start(1)] + "".join(f"{line}\n" for line in lines) + text[found.end(1) :]
