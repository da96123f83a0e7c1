"""Data sets as their pages show them: from the recipes shipped with oysterbench, or from records where there is no such
recipe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from oysterbench.core.errors import OysterbenchError
from oysterbench.hub.canonical import sha256
from oysterbench.hub.manifest import released_manifest
from oysterbench.recipe import SplitRecipe, load_split, split_names
from oysterbench.results.records import ResultRecord
from oysterbench.simulation.generate import digest
from oysterbench_leaderboard.boards.board import BoardInfo
from oysterbench_leaderboard.site.site import Site

Conditions = Mapping[str, float | str]


@dataclass(frozen=True)
class DataSet:
    """A split. Fields that a record does not tell are empty.

    sequences:  in order
    duration_s: of all sequences together; None where it is not known
    digest:     of the recipe, as in records
    manifest:   SHA-256 of the released manifest; size: of its files, bytes
    """

    name: str
    version: str
    track: str
    summary: str
    rig: str
    rig_summary: str
    seed: int | None
    hidden: bool
    digest: str
    sequences: tuple[str, ...]
    duration_s: float | None
    manifest: str = ""
    size: int | None = None
    recipe: str = ""


@lru_cache(maxsize=1)
def known() -> dict[str, DataSet]:
    """Data sets shipped with oysterbench, by name."""
    return {name: _of_recipe(load_split(name)) for name in split_names()}


def _of_recipe(split: SplitRecipe) -> DataSet:
    manifest = released_manifest(split.name, split.version)
    return DataSet(
        split.name,
        split.version,
        split.track,
        split.summary,
        split.rig.name,
        split.rig.summary,
        split.seed,
        split.hidden,
        digest(split),
        tuple(sequence.name for sequence in split.sequence),
        sum(sequence.duration_s for sequence in split.sequence),
        sha256(manifest.data) if manifest else "",
        manifest.size if manifest else None,
        "" if split.hidden else split.source,
    )


def all_data_sets(site: Site) -> dict[str, DataSet]:
    """Data sets shipped with oysterbench, followed by others that have records."""
    found = dict(known())
    for info in site.index.boards():
        if info.split not in found:
            found[info.split] = DataSet(
                name=info.split,
                version="",
                track=info.track,
                summary="",
                rig="",
                rig_summary="",
                seed=None,
                hidden=any(result.hidden for result in _results_of(site, info)),
                digest=info.split_digest,
                sequences=info.sequences,
                duration_s=None,
            )
    return found


def _results_of(site: Site, board: BoardInfo) -> tuple[ResultRecord, ...]:
    """Results of one record of a board; empty where it has none that can be read."""
    record = site.some_record(board.id)
    return record.results if record else ()


def conditions_of(site: Site, data_set: DataSet) -> dict[str, Conditions]:
    """Sequence -> its conditions, from the recipe or else from a record; empty where neither tells them."""
    if data_set.name in known():
        return dict(_of_sequences(data_set.name))
    for info in site.index.boards():
        if info.split == data_set.name and (results := _results_of(site, info)):
            like = {result.sequence: result.conditions for result in reversed(results)}
            return {name: like.get(name, {}) for name in data_set.sequences}
    return {}


@lru_cache(maxsize=1)
def classes_note() -> str:
    """Note on what the classes of water and density mean; they say nothing of the water's colour, or of how oysters are
    clustered. Empty without the packages that rendering needs."""
    try:
        from oysterbench.simulation.conditions import DENSITY_CLASSES_PER_M2, SECCHI_CLASSES_M
    except ImportError:  # without the packages that rendering needs
        return ""
    (turbid_m, turbid), (murky_m, murky), (_, clear) = SECCHI_CLASSES_M
    (bare_m2, bare), (sparse_m2, sparse), (_, dense) = DENSITY_CLASSES_PER_M2
    return (
        f"Water and density are classes. Water of any colour is {clear} from a Secchi depth of {murky_m:g} m on, "
        f"{murky} from {turbid_m:g} m, else {turbid}. A reef is {dense} from {sparse_m2:g} oysters on a square metre "
        f"on, counted over patches and gaps together, {sparse} from {bare_m2:g}, else {bare}."
    )


@lru_cache(maxsize=64)
def _of_sequences(split: str) -> dict[str, Conditions]:
    try:
        from oysterbench.simulation.conditions import conditions

        recipe = load_split(split)
        return {sequence.name: conditions(recipe, sequence.name) for sequence in recipe.sequence}
    except (ImportError, OysterbenchError):  # without the packages that rendering needs
        return {}
