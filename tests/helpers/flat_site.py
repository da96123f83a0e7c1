"""A site without a reef: a flat bottom, and oysters where a test puts them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from oysterbench.recipe import load_split
from oysterbench.simulation.steering.site import Site

BOTTOM = -5.0
SPLIT = load_split("steer-mini")


class FlatSite(Site):
    """floor and altitude over a plane at BOTTOM; a wall of height `wall_m` stands where x is beyond `wall_x`."""

    wall_x, wall_m = np.inf, 0.0

    def floor(self, x, y):
        return BOTTOM + self.task.hull_m + np.where(x > self.wall_x, self.wall_m, 0.0)

    def altitude(self, states):
        return states[..., 2] - BOTTOM


def flat_site(oysters, half_m=20.0, range_m=2.0):
    oysters = np.asarray(oysters, dtype=float).reshape(-1, 2)
    places = np.column_stack([oysters, np.full(len(oysters), BOTTOM)])
    ids = np.arange(1, len(oysters) + 1)
    world = SimpleNamespace(ground_height=lambda x, y: np.full(np.shape(x), BOTTOM), instances=ids)
    return FlatSite(SimpleNamespace(world=world), SPLIT.steering, SPLIT.rig.camera[0], half_m, range_m, ids, places)


def field(x, y, count=60, spread=0.6):
    """Oysters (count, 2) m in a square patch around x, y."""
    side = int(np.sqrt(count))
    lines = np.linspace(-spread, spread, side)
    return np.stack(np.meshgrid(x + lines, y + lines), axis=-1).reshape(-1, 2)
