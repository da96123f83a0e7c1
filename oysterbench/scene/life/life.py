"""Everything that moves by itself over a reef: a table of instances at any time, and a list of the things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import RecipeError
from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import LIFE_CLASSES, SequenceRecipe
from oysterbench.scene.instances import CLASS_NUMBERS, Instances
from oysterbench.scene.life.company import Company, gather
from oysterbench.scene.life.ground import build_ground
from oysterbench.scene.life.states import Group
from oysterbench.scene.life.sway import Sway, build_sway, life_waves
from oysterbench.scene.mesh import Mesh, round_positions
from oysterbench.scene.path import Path
from oysterbench.scene.world import MAX_INSTANCES, World

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Life:
    """Things that move by themselves. groups: of things that belong together; firsts: index of each group's first mesh
    in `meshes`. first_id: id of the first thing in instance images. sway: of the plants, None if they stand still."""

    groups: tuple[Group, ...]
    firsts: tuple[int, ...]
    meshes: tuple[Mesh, ...]
    first_id: int
    sway: Sway | None

    def __len__(self) -> int:
        """Number of rows of the instance table."""
        return sum(len(group.colours) for group in self.groups)

    def at(self, time_s: float) -> Instances:
        """Instances of the moving things at time_s, in `map`; shapes index `meshes`; the rows are the same at any
        time."""
        states = [group.at(time_s) for group in self.groups]
        rotations = np.concatenate([state.rotations for state in states])
        n = len(rotations)
        shapes = [first + state.forms for first, state in zip(self.firsts, states, strict=True)]
        return Instances(
            ids=self.ids,
            classes=np.repeat([CLASS_NUMBERS[g.class_name] for g in self.groups], self._sizes).astype(np.uint8),
            shapes=np.concatenate(shapes).astype(np.int32),
            positions=round_positions(np.concatenate([state.positions for state in states])),
            rotations=np.round(rotations, 6).astype(np.float32),
            scales=round_positions(np.concatenate([state.scales for state in states])),
            colours=np.round(np.concatenate([g.colours for g in self.groups]), 5).astype(np.float32),
            silt=np.zeros(n, dtype=np.float32),
            sunk=np.zeros(n, dtype=np.float32),
            hosts=np.zeros(n, dtype=np.uint16),
        )

    @property
    def count(self) -> int:
        """Number of things; all pieces of a tether count as one."""
        return sum(int(group.ids.max()) + 1 for group in self.groups)

    @property
    def ids(self) -> NDArray[np.uint16]:
        """Id of each row: the pieces of a tether share one."""
        counts = [int(group.ids.max()) + 1 for group in self.groups]
        starts = self.first_id + np.cumsum([0, *counts[:-1]])
        return np.concatenate([start + g.ids for start, g in zip(starts, self.groups, strict=True)]).astype(np.uint16)

    def table(self) -> pd.DataFrame:
        """Table of the moving things, one row each. id: as in instance images; class; kind: species or material; group:
        number of its group, even if alone in it; size_m: length of fish and debris, width of crabs, radius of the
        tether."""
        import pandas as pd

        rows = []
        first = self.first_id
        for number, group in enumerate(self.groups, start=1):
            sizes = group.at(0.0).scales[:, 1]
            for own in np.unique(group.ids).tolist():
                size = round(float(sizes[group.ids == own][0]), 4)
                rows.append((first + own, group.class_name, group.kind, number, size))
            first += int(group.ids.max()) + 1
        return pd.DataFrame(rows, columns=["id", "class", "kind", "group", "size_m"])

    def poses(self, times_s: Array, stamps_ns: NDArray[np.int64]) -> pd.DataFrame:
        """Poses at times (N,) s, one row per thing and stamp: stamp_ns, id; x, y, z m, qx, qy, qz, qw: pose of the
        thing's frame in `map` (x to the nose, z to the back). For a tether, that of its first piece, at the stern."""
        import pandas as pd

        tables = []
        first = np.unique(self.ids, return_index=True)[1]
        for time, stamp in zip(times_s.tolist(), stamps_ns.tolist(), strict=True):
            now = self.at(time).take(first)
            quaternions = Rotation.from_matrix(now.rotations.astype(float)).as_quat(canonical=True)
            columns = {"stamp_ns": np.full(len(first), stamp), "id": now.ids.astype(np.int64)}
            columns |= {name: np.round(now.positions[:, k].astype(float), 6) for k, name in enumerate("xyz")}
            columns |= {f"q{name}": np.round(quaternions[:, k], 6) + 0.0 for k, name in enumerate("xyzw")}
            tables.append(pd.DataFrame(columns))
        return pd.concat(tables, ignore_index=True)

    @property
    def _sizes(self) -> list[int]:
        return [len(group.colours) for group in self.groups]


def moving_classes(recipe: SequenceRecipe) -> list[int]:
    """Numbers of the classes that move by themselves in a sequence: animals and drifting things, the vehicle, and
    plants if they sway."""
    moving = [*LIFE_CLASSES, CLASS_NUMBERS["vehicle"]]
    return [*moving, CLASS_NUMBERS["plant"]] if recipe.life.sway else moving


def build_life(recipe: SequenceRecipe, world: World, path: Path, streams: Streams) -> Life | None:
    """Build what moves by itself in a sequence, None if nothing does; the same recipe and streams give the same result.

    Raises RecipeError if there are more things than instance ids.
    """
    life = recipe.life
    if not life.moves and not life.sway:
        return None
    waves = life_waves(recipe, streams)
    sway = build_sway(world, recipe, waves)
    company: Sequence[Company] = ()
    if life.moves:
        company = gather(recipe, build_ground(world), path, waves, streams.at("life"))
    if len(world.instances) + 1 + sum(len(one.group.colours) for one in company) > MAX_INSTANCES:
        raise RecipeError(
            f"sequence {recipe.name}: keys 'life.schools', 'school_size', 'fish', 'crabs', 'debris': more things "
            f"together with the reef's {len(world.instances)} than the {MAX_INSTANCES} that instance images tell apart"
        )
    meshes: list[Mesh] = []
    firsts, begins = [], {}
    for one in company:
        if one.meshes[0] not in begins:  # groups of a species share its meshes
            begins[one.meshes[0]] = len(meshes)
            meshes += one.meshes[1]()
        firsts.append(begins[one.meshes[0]])
    groups = tuple(one.group for one in company)
    return Life(groups, tuple(firsts), tuple(meshes), len(world.instances) + 2, sway)
