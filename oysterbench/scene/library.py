"""The library of a world: every mesh that its instances may use, each drawn from its own random stream."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.streams import Streams
from oysterbench.recipe import ReefRecipe
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.oyster import Shell, build_oyster
from oysterbench.scene.plants import build_bunch, build_strand, build_tuft
from oysterbench.scene.props import build_fragment, build_sponge, build_stone

SHELLS = {"live": 28, "box": 6, "left valve": 6, "right valve": 5}
PROPS = {"stone": 10, "rock": 5, "fragment": 10, "tuft": 10, "sponge": 6, "bunch": 6, "strand": 8}
ROCK_SUBDIVISIONS = 4
BROAD_SHARE = 0.4  # share of the tuft meshes that are broad algae, not seagrass
THREADS_FROM = 0.5  # share of the strand meshes that are blades; the others are stalks and threads


@dataclass(frozen=True)
class Library:
    """Shells, from round to slender within each state, followed by the other meshes that the recipe needs.

    first: index of the first mesh of each kind; count: number of meshes of each kind.
    """

    shells: tuple[Shell, ...]
    props: tuple[Mesh, ...]
    first: dict[str, int]
    count: dict[str, int]

    @cached_property
    def meshes(self) -> tuple[Mesh, ...]:
        """All meshes, in the order indexed by Instances.shapes."""
        return (*(shell.mesh for shell in self.shells), *self.props)

    def pick(self, kind: str, share: NDArray[np.float64]) -> NDArray[np.int64]:
        """Indices (N,) of meshes of a kind, selected by share (N,), which runs through them in order from 0 to 1."""
        count = self.count[kind]
        return self.first[kind] + np.clip((share * count).astype(np.int64), 0, count - 1)


def build_library(reef: ReefRecipe, streams: Streams) -> Library:
    """Build the meshes that a recipe needs."""
    first, count, shells = {}, dict(SHELLS), 0
    for state, number in SHELLS.items():
        first[state], shells = shells, shells + number
    wanted = {
        "stone": reef.stones > 0,
        "rock": reef.rocks > 0,
        "fragment": reef.hash_per_m2 > 0,
        "tuft": reef.plant_cover > 0,
        "sponge": reef.sponges_per_m2 > 0,
        "bunch": reef.algae_per_m2 > 0,
        "strand": reef.litter_per_m2 > 0,
    }
    props: list[Mesh] = []
    for kind, number in PROPS.items():
        first[kind], count[kind] = shells + len(props), number if wanted[kind] else 0
        if wanted[kind]:
            props += build_props(kind, streams)
    return Library(build_shells(streams), tuple(props), first, count)


@lru_cache(maxsize=2)
def build_shells(streams: Streams) -> tuple[Shell, ...]:
    """Build all shells. They do not depend on the recipe: reefs with the same streams share them, and their search
    trees on a device."""
    return tuple(
        build_oyster(streams.generator("shell", state, k), state, (k + 0.5) / number)[1]
        for state, number in SHELLS.items()
        for k in range(number)
    )


@lru_cache(maxsize=2 * len(PROPS))
def build_props(kind: str, streams: Streams) -> tuple[Mesh, ...]:
    """Build all meshes of a kind, shared in the same way as the shells."""
    return tuple(_build_prop(kind, k, streams.generator(kind, k)) for k in range(PROPS[kind]))


def _build_prop(kind: str, k: int, generator: np.random.Generator) -> Mesh:
    """Build the k-th mesh of a kind."""
    if kind == "stone":
        return build_stone(generator)
    if kind == "rock":
        return build_stone(generator, ROCK_SUBDIVISIONS)
    if kind == "fragment":
        return build_fragment(generator)
    if kind == "tuft":
        return build_tuft(generator, broad=k < BROAD_SHARE * PROPS[kind])
    if kind == "bunch":
        return build_bunch(generator)
    if kind == "strand":
        return build_strand(generator, thread=k >= THREADS_FROM * PROPS[kind])
    return build_sponge(generator)
