"""Values of a recipe that are drawn from a range."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import RecipeError
from tests.helpers.tiny import TINY_SPLIT, make_split


@pytest.mark.parametrize("between", [[1.0, 2.0], [3.0, 9.0]])
def test_a_duration_is_not_drawn(between):
    """As many frames are rendered as the recipe's own duration has, and the files show it to everybody."""
    text = TINY_SPLIT.replace(
        "[sequence.path]", f'[[sequence.drawn]]\nkey = "duration_s"\nbetween = {between}\n\n[sequence.path]'
    )
    with pytest.raises(RecipeError) as refused:
        make_split(text)
    assert str(refused.value) == (
        "tiny.toml: sequence tiny-01: key 'drawn': expected keys other than 'duration_s', which the files show anyway; "
        "state the duration as a number"
    )


def test_a_key_has_one_range():
    ranges = "".join(f'[[sequence.drawn]]\nkey = "path.speed_m_s"\nbetween = [0.2, {high}]\n\n' for high in (0.3, 0.4))
    with pytest.raises(RecipeError, match=r"expected one range for each key, got several for 'path\.speed_m_s'"):
        make_split(TINY_SPLIT.replace("[sequence.path]", f"{ranges}[sequence.path]"))
