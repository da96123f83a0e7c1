"""The library of a world: every mesh that its instances may use, each from a stream of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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
BROAD_SHARE = 0.4  # share of the tufts that are broad algae, not seagrass
THREADS_FROM = 0.5  # share of the strands that are blades; the others are stalks and threads


@dataclass(frozen=True)
class Library:
    """Shells, from round to slender within each state, then what else the recipe asks for.

    first: where the meshes of each kind begin.
    """

    shells: tuple[Shell, ...]
    props: tuple[Mesh, ...]
    first: dict[str, int]
    count: dict[str, int]

    @cached_property
    def meshes(self) -> tuple[Mesh, ...]:
        """All meshes, in the order that Instances.shapes counts."""
        return (*(shell.mesh for shell in self.shells), *self.props)

    def pick(self, kind: str, share: NDArray[np.float64]) -> NDArray[np.int64]:
        """Indices (N,) of meshes of a kind; share (N,) from 0 to 1 runs through them in their order."""
        count = self.count[kind]
        return self.first[kind] + np.clip((share * count).astype(np.int64), 0, count - 1)


def build_library(reef: ReefRecipe, streams: Streams) -> Library:
    """The meshes that a recipe needs."""
    shells: list[Shell] = []
    first, count = {}, {}
    for state, number in SHELLS.items():
        first[state], count[state] = len(shells), number
        for k in range(number):
            shells.append(build_oyster(streams.generator("shell", state, k), state, (k + 0.5) / number)[1])
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
        first[kind], count[kind] = len(shells) + len(props), number if wanted[kind] else 0
        for k in range(count[kind]):
            generator = streams.generator(kind, k)
            if kind == "stone":
                props.append(build_stone(generator))
            elif kind == "rock":
                props.append(build_stone(generator, ROCK_SUBDIVISIONS))
            elif kind == "fragment":
                props.append(build_fragment(generator))
            elif kind == "tuft":
                props.append(build_tuft(generator, broad=k < BROAD_SHARE * number))
            elif kind == "bunch":
                props.append(build_bunch(generator))
            elif kind == "strand":
                props.append(build_strand(generator, thread=k >= THREADS_FROM * number))
            else:
                props.append(build_sponge(generator))
    return Library(tuple(shells), tuple(props), first, count)
