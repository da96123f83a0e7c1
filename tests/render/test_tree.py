"""Trees of boxes: every item is in one leaf, and every box holds what lies below it."""

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.render.camera import CameraRenderer
from oysterbench.render.rays import RayCaster
from oysterbench.render.tree import WIDTH, Forest, build_forest
from oysterbench.scene.world import build_world
from tests.helpers.reefs import CAMERA, small_reef, world_of


def items_below(forest: Forest, low: np.ndarray, high: np.ndarray, node: int) -> list[int]:
    """Items under a node, each within the boxes on its way."""
    found: list[int] = []
    for k in range(WIDTH):
        child = int(forest.children[node, k])
        sides = forest.planes[6 * node : 6 * node + 6, k]
        if np.isinf(sides).any():
            continue
        if child < 0:
            below = [int(item) for item in forest.leaves[-1 - child] if item >= 0]
        else:
            below = items_below(forest, low, high, child)
        assert (low[below] >= sides[::2]).all()
        assert (high[below] <= sides[1::2]).all()
        found += below
    return found


@pytest.mark.parametrize("leaf", [1, 4])
def test_every_item_lies_in_one_leaf_of_its_tree_within_all_boxes_above(leaf: int) -> None:
    generator = np.random.default_rng(3)
    counts = [1, 2, 4, 5, 17, 300]
    low = generator.random((sum(counts), 3)).astype(np.float32)
    high = low + generator.random(low.shape).astype(np.float32) * np.float32(0.1)
    forest = build_forest(low, high, counts, leaf)
    end = np.cumsum(counts)
    for root, first, last in zip(forest.roots, end - counts, end, strict=True):
        assert sorted(items_below(forest, low, high, int(root))) == list(range(first, last))


def test_leaves_are_full_but_for_one_of_each_tree() -> None:
    low = np.random.default_rng(4).random((4 * 50 + 3, 3)).astype(np.float32)
    forest = build_forest(low, low, [len(low)], 4)
    assert ((forest.leaves >= 0).sum(axis=1) < 4).sum() == 1


def test_boxes_that_are_all_one_are_divided_all_the_same() -> None:
    low = np.zeros((100, 3), dtype=np.float32)
    forest = build_forest(low, low, [100], 1)
    assert sorted(items_below(forest, low, low, 0)) == list(range(100))


def test_cameras_and_sonars_of_a_reef_share_its_meshes() -> None:
    recipe = small_reef({})
    world, again, other = world_of(recipe), world_of(recipe), build_world(recipe, Streams(5))
    camera, sonar, same, elsewhere = CameraRenderer(world, CAMERA, recipe), *map(RayCaster, (world, again, other))
    assert camera._geometry.library.planes.ptr == sonar._geometry.library.planes.ptr
    assert camera._geometry.library.planes.ptr == same._geometry.library.planes.ptr, "its shells are the same"
    assert camera._geometry.library.planes.ptr != elsewhere._geometry.library.planes.ptr
