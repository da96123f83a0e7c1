"""Random streams depend on seed, salt and name, and on nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.streams import Streams, stream

PINNED = [7666937753753021998, 8652682877450533488, 3312017456099647878, 8829603598751991557]


def draw(*name, seed=1, salt=b"") -> list[int]:
    return stream(seed, salt, *name).integers(0, 2**63, 4).tolist()


def test_a_stream_is_the_same_each_time():
    assert draw("scene", "oyster", 17) == draw("scene", "oyster", 17)


def test_streams_of_other_names_seeds_and_salts_differ():
    names = [("a", 1), ("a1",), ("a", "1"), (1, "a"), ("a",), (), ("a", 1, ""), ("a", -1)]
    draws = [draw(*name) for name in names]
    draws += [draw("a", seed=2), draw("a", salt=b"s"), draw("a", seed=-1)]
    assert len({tuple(numbers) for numbers in draws}) == len(draws)


def test_the_bytes_of_a_stream_never_change():
    """Pinned: every released split depends on these numbers."""
    assert draw("scene", "oyster", 17) == PINNED


def test_a_branch_names_the_same_streams():
    branch = Streams(1, b"salt").at("scene").at("oyster", 17)
    np.testing.assert_array_equal(
        branch.generator("height").random(3), stream(1, b"salt", "scene", "oyster", 17, "height").random(3)
    )


def test_drawing_from_one_stream_moves_no_other():
    streams = Streams(7)
    before = streams.generator("b").random(3)
    streams.generator("a").random(1000)
    np.testing.assert_array_equal(streams.generator("b").random(3), before)


@pytest.mark.parametrize("shift", [0, 1])
def test_neighbouring_streams_are_uncorrelated(shift):
    a = stream(1, b"", "pixel", 1).normal(size=20_000)
    b = stream(1, b"", "pixel", 2).normal(size=20_000)
    assert abs(np.corrcoef(a, np.roll(b, shift))[0, 1]) < 4 / np.sqrt(20_000)
