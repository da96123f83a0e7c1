"""What the library is to its users: each name has an example, which the doctests run."""

from __future__ import annotations

import inspect

import pytest

import oysterbench

WITHOUT = {"OysterbenchError", "SlamResult"}
"""Which nobody makes; those of `score` show the second."""


def names():
    """All public names, and those of metrics; data sets for PyTorch have theirs where that is installed."""
    yield from (name for name in oysterbench.__all__ if name not in ("torch", "__version__"))
    yield from (f"metrics.{name}" for name in oysterbench.metrics.__all__)


@pytest.mark.parametrize("name", sorted(names()))
def test_a_public_name_says_what_it_is_and_has_an_example(name):
    found = oysterbench
    for part in name.split("."):
        found = getattr(found, part)
    text = inspect.getdoc(found) or ""
    assert len(text) > 20
    if inspect.isfunction(found) or (inspect.isclass(found) and name not in WITHOUT):
        assert ">>> " in text


def test_metrics_are_plain_numbers(dive_file):
    sequence = oysterbench.open(dive_file)
    result = oysterbench.score(sequence, sequence.truth())
    assert {type(value) for value in result.metrics.values()} <= {float, int}
    assert type(oysterbench.metrics.ate(sequence.truth(), sequence.truth())) is float
    assert type(oysterbench.metrics.iou([[1, 0]], [[1, 1]])) is float
