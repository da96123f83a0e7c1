"""Stones, broken shell, plants and sponges: closed, outward, of unit size, each its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from oysterbench.core.streams import Streams
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.plants import build_tuft
from oysterbench.scene.props import build_fragment, build_sponge, build_stone

KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "stone": build_stone,
    "rock": lambda generator: build_stone(generator, 4),
    "fragment": build_fragment,
    "seagrass": lambda generator: build_tuft(generator, broad=False),
    "algae": lambda generator: build_tuft(generator, broad=True),
    "sponge": build_sponge,
}


@pytest.mark.parametrize("kind", KINDS)
def test_prop_is_watertight_outward_and_about_unit_size(kind: str) -> None:
    for k in range(3):
        mesh = KINDS[kind](Streams(1).generator(kind, k))
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert all(part.volume > 0 for part in solid.split())
        assert 0.6 < np.ptp(mesh.vertices, axis=0).max() < 3.2


@pytest.mark.parametrize("kind", KINDS)
def test_prop_repeats_with_its_stream_and_differs_from_the_next(kind: str) -> None:
    one, again, other = (KINDS[kind](Streams(1).generator(kind, k)).vertices for k in (0, 0, 1))
    assert np.array_equal(one, again)
    assert one.shape != other.shape or not np.array_equal(one, other)
