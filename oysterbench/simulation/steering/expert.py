"""The expert: it sees the ground truth, plans a few steps ahead, and commands what gains most views of live oysters.

A receding-horizon beam search. For each pair of classes that a plan may start with, the best few continuations are
kept from step to step. The value of a plan is the number of oysters that its images show for the first time, minus the
costs of leaving the altitude band, of contact and of being turned at the fence, plus what waits where it ends: the best
remaining spot, discounted by the time it takes to get there. Views are computed for cells of the bottom, from range and
image edges; occlusion is not modelled, and shows only in the images themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.recipe import SteeringRecipe
from oysterbench.simulation.steering.site import Site
from oysterbench.simulation.steering.vehicle import advance, folded, rotations, turns

CELL_M = 0.25
SPOT_M = 1.0  # size of the cells of what waits farther away
PICTURE_INSET = 0.95  # share of the image's half width and height: what its edge cuts off does not count as seen


@dataclass(frozen=True)
class Plan:
    """Parameters of the expert's search. Costs are in oysters."""

    steps: int = 5
    beam: int = 2
    yaw_stride: int = 1
    """Continuations use every class of yaw, or every second or third, counted from straight ahead."""
    pitch_stride: int = 2
    discount: float = 0.97
    """Factor per step on later gains, which are less certain."""
    patience_s: float = 18.0
    """Time after which the value of what waits has fallen to 1/e."""
    waiting: float = 1.0
    """Weight of what waits, relative to what an image shows."""
    band_cost: float = 300.0
    """Cost of a step per metre outside the altitude band."""
    contact_cost: float = 100.0
    """Cost of a step that touches something, or after which a step straight ahead would."""
    fence_cost: float = 3.0
    turn_cost: float = 0.005
    """Cost per class away from straight ahead, in units of the best spot's oysters: prefers the calmer of two equally
    good commands."""


class Expert:
    """Expert for a site: values of the commands at a state, given which of the site's oysters have been seen."""

    def __init__(self, site: Site, plan: Plan = Plan()) -> None:
        self.site = site
        self.plan = plan
        task = site.task
        self._yaw, self._pitch = turns(task)
        self._straight = (task.yaw_deg.index(0.0), task.pitch_deg.index(0.0))
        size = max(1, round(2 * site.half_m / CELL_M))
        place = np.clip(((site.oysters[:, :2] + site.half_m) / (2 * site.half_m) * size).astype(int), 0, size - 1)
        self._cells, self._cell_of = np.unique(place[:, 1] * size + place[:, 0], return_inverse=True)
        held = np.maximum(np.bincount(self._cell_of), 1)
        self._centres = np.stack(
            [np.bincount(self._cell_of, weights=site.oysters[:, k]) / held for k in range(3)], axis=-1
        ).reshape(-1, 3)
        spots = max(1, round(2 * site.half_m / SPOT_M))
        self._spots_per_side = spots
        lines = (np.arange(spots) + 0.5) / spots * 2 * site.half_m - site.half_m
        x, y = np.meshgrid(lines, lines)
        self._spots = np.stack([x.ravel(), y.ravel()], axis=-1)
        spot = np.clip(((self._centres[:, :2] + site.half_m) / (2 * site.half_m) * spots).astype(int), 0, spots - 1)
        self._spot_of = spot[:, 1] * spots + spot[:, 0]

    def command(self, state: Array, found: NDArray[np.bool_]) -> tuple[int, int]:
        """Best classes of yaw and pitch at a state (5,), where `found` (N,) marks the oysters seen so far."""
        return best(self.values(state, found))

    def values(self, state: Array, found: NDArray[np.bool_]) -> Array:
        """Values (Y, P) of the best plans that start with each pair of classes, in oysters, rounded to 1e-4."""
        task, plan = self.site.task, self.plan
        counts = np.bincount(self._cell_of[~found], minlength=len(self._cells)).astype(np.float32)
        waiting: Array = np.asarray(
            np.bincount(self._spot_of, weights=counts, minlength=self._spots_per_side**2), dtype=float
        )
        far = task.speed_m_s * task.step_s * plan.steps + self.site.range_m
        near = np.flatnonzero((counts > 0) & (np.linalg.norm(self._centres[:, :2] - state[:2], axis=1) <= far))
        centres, counts = self._centres[near], counts[near]

        classes = np.stack(np.meshgrid(np.arange(len(self._yaw)), np.arange(len(self._pitch)), indexing="ij"), axis=-1)
        roots = classes.reshape(-1, 2)
        calm = plan.turn_cost * max(1.0, float(waiting.max()))
        states, value = self._step(np.repeat(state[None], len(roots), axis=0), roots, 0, calm)
        shown = self._shows(states, centres)
        value += shown @ counts
        root = np.arange(len(roots))
        onward = self._onward()
        for step in range(1, plan.steps):
            parent = np.repeat(np.arange(len(states)), len(onward))
            moved, gained = self._step(states[parent], np.tile(onward, (len(states), 1)), step, calm)
            fresh = self._shows(moved, centres) & ~shown[parent]
            total = value[parent] + gained + plan.discount**step * (fresh @ counts)
            kept = self._best_of(root[parent], total + self._waits(moved, waiting))
            states, value, root = moved[kept], total[kept], root[parent][kept]
            shown = shown[parent[kept]] | fresh[kept]
        value = value + self._waits(states, waiting)
        values = np.full(len(roots), -np.inf)
        np.maximum.at(values, root, value)
        return np.round(values.reshape(len(self._yaw), len(self._pitch)), 4)

    def _onward(self) -> NDArray[np.intp]:
        """Pairs of classes (C, 2) that plans may continue with."""
        strides = (self.plan.yaw_stride, self.plan.pitch_stride)
        sides = [
            np.arange(straight % stride, len(turn), stride)
            for straight, stride, turn in zip(self._straight, strides, (self._yaw, self._pitch), strict=True)
        ]
        return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)

    def _step(self, states: Array, classes: NDArray[np.intp], step: int, calm: float) -> tuple[Array, Array]:
        """States (N, 5) after commands (N, 2), and their negated costs (N,); calm: cost per class off straight on."""
        site, plan, task = self.site, self.plan, self.site.task
        path = advance(states, self._yaw[classes[:, 0]], self._pitch[classes[:, 1]], task)
        path, turned = folded(path, site.half_m)
        low, high = task.altitude_m
        after = path[:, -1]
        altitude = site.altitude(after)
        outside = np.maximum(low - altitude, 0.0) + np.maximum(altitude - high, 0.0)
        ahead = advance(after, np.zeros(len(after)), np.zeros(len(after)), task)
        course = np.concatenate([path, ahead], axis=1)[:, ::2]
        touches = (course[..., 2] < site.floor(course[..., 0], course[..., 1])).any(axis=1)
        cost = plan.band_cost * outside + plan.contact_cost * touches + plan.fence_cost * turned.any(axis=1)
        cost += calm * np.abs(classes - self._straight).sum(axis=1)
        return after, -(plan.discount**step) * cost

    def _shows(self, states: Array, centres: Array) -> NDArray[np.bool_]:
        """Whether an image taken at each state shows each place, (N, M) bool."""
        site = self.site
        body = rotations(states)
        camera = (body @ site.mount[:3, :3]).astype(np.float32)
        eye = states[:, :3] + body @ site.mount[:3, 3]
        away = (centres[None] - eye[:, None]).astype(np.float32)
        seen = away @ camera  # (N, M, 3): right, down, forward
        right, down, forward = (seen[..., k] for k in range(3))
        wide, tall = (PICTURE_INSET * slope for slope in site.slopes)
        inside = (np.abs(right) <= wide * forward) & (np.abs(down) <= tall * forward)
        near: NDArray[np.bool_] = inside & (np.einsum("nmk,nmk->nm", seen, seen) <= site.range_m**2)
        return near

    def _waits(self, states: Array, waiting: Array) -> Array:
        """Values (N,) of the best remaining spot, discounted by the time to turn and travel to it."""
        spots = np.flatnonzero(waiting)
        if not len(spots):
            return np.zeros(len(states))
        task = self.site.task
        away = self._spots[spots][None] - states[:, None, :2]
        bearing = np.arctan2(away[..., 1], away[..., 0]) - states[:, None, 3]
        turn = np.abs(np.remainder(bearing + np.pi, 2 * np.pi) - np.pi)
        time_s = np.linalg.norm(away, axis=-1) / task.speed_m_s + turn / self._yaw.max() * task.step_s
        value: Array = waiting[spots] * np.exp(-time_s / self.plan.patience_s)
        best: Array = value.max(axis=1)
        return self.plan.waiting * best

    def _best_of(self, root: NDArray[np.intp], value: Array) -> NDArray[np.intp]:
        """Indices of the best `beam` plans of each root; ties go to the first."""
        order = np.lexsort((np.arange(len(root)), -np.round(value, 4), root))
        first = np.searchsorted(root[order], root[order])
        return order[np.arange(len(order)) - first < self.plan.beam]


def best(values: Array) -> tuple[int, int]:
    """Classes with the greatest value; ties go to the first."""
    yaw, pitch = np.unravel_index(int(np.argmax(values)), values.shape)
    return int(yaw), int(pitch)


def altitude_pitch(site: Site, state: Array, ahead_s: float = 2.0) -> int:
    """Class of pitch that brings a vehicle to the middle of the altitude band over the bottom ahead."""
    task: SteeringRecipe = site.task
    reach = task.speed_m_s * ahead_s
    x, y = state[0] + reach * np.cos(state[3]), state[1] + reach * np.sin(state[3])
    bottom = max(float(site.world.ground_height(px, py)) for px, py in ((state[0], state[1]), (x, y)))
    wanted = bottom + 0.5 * sum(task.altitude_m)
    down = np.arctan2(state[2] - wanted, reach)
    limit = np.radians(task.max_pitch_deg)
    pitch = turns(task)[1]
    return int(np.argmin(np.abs(state[4] + pitch - np.clip(down, -limit, limit))))
