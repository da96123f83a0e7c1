"""A split: the TOML file that defines it, found by its name or path, read and checked as a whole."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from oysterbench.core.errors import RecipeError
from oysterbench.core.names import PLAIN, instead, is_plain
from oysterbench.core.streams import Streams
from oysterbench.recipe.drawn import draw
from oysterbench.recipe.keys import as_plain, build, choice, number, stated
from oysterbench.recipe.life import check_life
from oysterbench.recipe.path import check_path
from oysterbench.recipe.rig import RigRecipe, read_rig, vary_rig
from oysterbench.recipe.scene import SequenceRecipe
from oysterbench.recipe.steering import SteeringRecipe, check_steering
from oysterbench.recipe.turbidity import check_plumes

LONGEST_NAME = 100
"""Characters of a name: with what files and folders add to it, they stay below the 255 that disks allow."""

TRACKS = ("slam", "segmentation", "steering")
"""Purposes of a split; one with masks of every oyster serves both segmentation and detection."""


@dataclass(frozen=True, kw_only=True)
class SplitRecipe:
    """A split: the content of its TOML file, plus the rig that it names.

    A table `[defaults]` of the file holds what its sequences have in common: each `[[sequence]]` states only what
    differs, key by key, at any depth; lists are replaced as a whole.
    """

    name: str  # letters, digits, '-' and '_'; part of the name of the folder that the files go to
    version: str  # letters, digits, '.', '-' and '_', from a letter or digit on; part of that name, too
    track: str = choice(TRACKS)  # what the data is for, and so which ground truth is scored
    seed: int = number(0, 2**63 - 1)  # seed of everything random: the same seed gives the same bytes
    summary: str  # one line for `oysterbench splits`
    hidden: bool = False  # rendered only with a secret salt, so that nobody else can reproduce the ground truth
    sequence: tuple[SequenceRecipe, ...]  # at least one
    steering: SteeringRecipe | None = None  # required for track steering, and refused for others
    rig: RigRecipe  # name of a rig, or path of its file: see above
    rig_source: str = field(repr=False)  # text of the rig's file
    source: str = field(repr=False)  # text of the split's file

    def find_sequence(self, name: str) -> SequenceRecipe:
        """Return the sequence of that name. Raises RecipeError where there is none."""
        for sequence in self.sequence:
            if sequence.name == name:
                return sequence
        recipe = self.name if self.name in split_names() else "RECIPE.toml"
        names = [sequence.name for sequence in self.sequence]
        other = instead(name, names, f"oysterbench splits {recipe}")
        raise RecipeError(f"split {self.name} has no sequence {name!r}; {other}")

    def rig_of(self, sequence: SequenceRecipe) -> RigRecipe:
        """Rig of a sequence, with the values that the sequence changes."""
        return vary_rig(self.rig, sequence.rig, f"split {self.name}: sequence {sequence.name}")

    def streams_of(self, sequence: SequenceRecipe, salt: bytes = b"") -> Streams:
        """Random streams of a sequence: its own, or those of the dive that it repeats."""
        return Streams(self.seed, salt, (sequence.same_dive_as or sequence.name,))

    def drawn(self, sequence: SequenceRecipe, salt: bytes = b"") -> SequenceRecipe:
        """The sequence with its drawn values filled in, as it is rendered."""
        streams = self.streams_of(sequence, salt)
        where = f"split {self.name}: sequence {sequence.name}"
        return draw(sequence, lambda key: float(streams.generator("drawn", key).random()), where)

    @property
    def texts(self) -> dict[str, bytes]:
        """Texts of recipe and rig, by the names under which every sequence file keeps them."""
        return {"split.toml": self.source.encode(), "rig.toml": self.rig_source.encode()}

    def digest(self) -> str:
        """SHA-256 of the values of recipe and rig: two recipes with the same digest make the same data. Their texts,
        with comments and summary, are kept in the files, too, and are not part of it."""
        values = {k: v for k, v in stated(self).items() if k not in ("source", "rig_source", "summary")}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def split_names() -> list[str]:
    """Names of the splits that come with oysterbench."""
    folder = resources.files("oysterbench_datasets") / "splits"
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_split(name_or_path: str) -> SplitRecipe:
    """Read a split by its name, or a TOML file by its path.

    Raises RecipeError naming the file, the key, the value and what is allowed.
    """
    path = Path(name_or_path)
    if name_or_path.endswith(".toml"):
        source = _read_text(path, f"{path}: no such recipe; `oysterbench splits` lists the known splits")
    else:
        known = split_names()
        if name_or_path not in known:
            other = instead(name_or_path, known, "oysterbench splits")
            raise RecipeError(f"unknown split {name_or_path!r}; {other}, and a recipe's path ends with .toml")
        path = Path(str(resources.files("oysterbench_datasets") / "splits" / f"{name_or_path}.toml"))
        source = _read_text(path, f"{path}: no such recipe")
    return parse_split(source, str(path))


def parse_split(source: str, where: str, rig_source: str | None = None) -> SplitRecipe:
    """Parse a split from the text of its recipe; the rig is found by its name unless its text is given."""
    table = _parse_toml(source, where)
    rig_name = table.pop("rig", None)
    if not isinstance(rig_name, str):
        raise RecipeError(
            f"{where}: key 'rig': expected the name of a file in datasets/rigs, or the path of a .toml file beside the "
            f"recipe, got {rig_name!r}"
        )
    _merge_defaults(table, where)
    rig_source = _rig_text(rig_name, where) if rig_source is None else rig_source
    rig = _read_rig(rig_source, f"rig {rig_name}")
    table = {**table, "rig": rig, "rig_source": rig_source, "source": source}
    split = build(SplitRecipe, table, where, "")
    _check_split(split, where)
    return split


def _merge_defaults(table: dict[str, Any], where: str) -> None:
    """Merge the table `defaults` into each sequence, whose own values take precedence."""
    defaults = table.pop("defaults", {})
    sequences = table.get("sequence")
    if not isinstance(defaults, dict) or "name" in defaults:
        raise RecipeError(f"{where}: key 'defaults': expected a table of keys of a sequence, without name")
    if defaults and isinstance(sequences, list) and all(isinstance(sequence, dict) for sequence in sequences):
        table["sequence"] = [_merged(defaults, sequence) for sequence in sequences]


def _merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge two tables key by key, at any depth; where both have a value, that of `over` is taken."""
    merged = {**under, **over}
    for key in under.keys() & over.keys():
        if isinstance(under[key], dict) and isinstance(over[key], dict):
            merged[key] = _merged(under[key], over[key])
    return merged


def rig_tables(source: str, rig_source: str, sequence: str) -> dict[str, Any]:
    """Tables of the rig of a sequence, with what the sequence changes, by the texts of split and rig that its file
    keeps. They are not checked, so files of older recipes can be read too; keys that are not stated are absent."""
    table, rig = tomllib.loads(source), tomllib.loads(rig_source)
    _merge_defaults(table, "split.toml")
    changes: dict[str, Any] = next(
        (one.get("rig", {}) for one in table.get("sequence", []) if one["name"] == sequence), {}
    )
    for block, values in changes.items():
        old = rig.get(block, [])  # a rig without lamps has nothing to change
        rig[block] = [{**one, **values} for one in old] if isinstance(old, list) else {**old, **values}
    return rig


def with_rig(split: SplitRecipe, rig_name: str, where: str) -> SplitRecipe:
    """Return the split with another rig, given by its name or by the path of its file relative to that of `where`."""
    source = _rig_text(rig_name, where)
    other = dataclasses.replace(split, rig=_read_rig(source, f"rig {rig_name}"), rig_source=source)
    _check_split(other, where)
    return other


def vary_split(split: SplitRecipe, changes: Mapping[str, Any], where: str) -> SplitRecipe:
    """Return the split with its first sequence only, and with some values replaced, each checked like those of a file.

    Keys of `changes` are those of a sequence (`water.jerlov`) or, after `camera.` or `lamp.`, of all the rig's cameras
    or lamps (`camera.pitch_deg`).
    """
    sequence, rig = as_plain(split.sequence[0]), as_plain(split.rig)
    if "water.type" in changes:  # stands in for the other key
        sequence["water"].pop("jerlov", None)
    for key, value in changes.items():
        first, *rest = key.split(".")
        tables = rig[first] if first in ("camera", "lamp") else [sequence]
        path = rest if first in ("camera", "lamp") else [first, *rest]
        for table in tables:
            for parent in path[:-1]:
                if not isinstance(table.get(parent), dict):
                    raise RecipeError(f"{where}: unknown key {key!r}; known keys here: {', '.join(table)}")
                table = table[parent]
            table[path[-1]] = value
    varied = dataclasses.replace(
        split,
        sequence=(build(SequenceRecipe, sequence, where, ""),),
        rig=read_rig(rig, f"{where}: rig {split.rig.name}"),
    )
    _check_split(varied, where)
    return varied


def _rig_text(name: str, where: str) -> str:
    if name.endswith(".toml"):
        path = Path(where).parent / name
    else:
        path = Path(str(resources.files("oysterbench_datasets") / "rigs" / f"{name}.toml"))
    return _read_text(path, f"{where}: key 'rig': there is no rig {name!r} ({path} is absent)")


def _read_rig(source: str, where: str) -> RigRecipe:
    return read_rig(_parse_toml(source, where), where)


def _check_split(split: SplitRecipe, where: str) -> None:
    """Check what no single key can express. Raises RecipeError, which starts with `where`."""
    if (split.steering is not None) != (split.track == "steering"):
        wanted = "a table [steering]" if split.track == "steering" else "no table [steering]"
        raise RecipeError(f"{where}: key 'steering': expected {wanted} for track = {split.track!r}")
    if split.steering is not None:
        check_steering(split.steering, where)
        if any(draw(sequence, lambda key: 1.0, where).life.moves for sequence in split.sequence):
            raise RecipeError(f"{where}: key 'sequence.life': expected nothing that moves for track = 'steering'")
    if not split.sequence:
        raise RecipeError(f"{where}: expected at least one [[sequence]], got none")
    _check_names(split, where)
    for sequence in split.sequence:
        place = f"{where}: sequence {sequence.name}"
        bases = [other.name for other in split.sequence if not other.same_dive_as and other is not sequence]
        if sequence.same_dive_as and sequence.same_dive_as not in bases:
            known = f"one of {', '.join(bases)}" if bases else "which this split does not have"
            raise RecipeError(
                f"{place}: key 'same_dive_as': expected another sequence that is a dive of its own, {known}; got "
                f"{sequence.same_dive_as!r}"
            )
        if bool(sequence.disturbance) != bool(sequence.strength):
            raise RecipeError(
                f"{place}: keys 'disturbance', 'strength': expected both or neither, got {sequence.disturbance!r} of "
                f"strength {sequence.strength}"
            )
        vary_rig(split.rig, sequence.rig, place)
        for ends in (lambda key: 0.0), (lambda key: 1.0):
            _check_sequence(draw(sequence, ends, place), place)


def _check_names(split: SplitRecipe, where: str) -> None:
    """Check the names that files and folders get. Raises RecipeError, which starts with `where`."""
    names = [sequence.name for sequence in split.sequence]
    if len(set(names)) != len(names):
        raise RecipeError(f"{where}: key 'sequence.name': names must differ, got {names}")
    for key, name in (("name", split.name), *(("sequence.name", name) for name in names)):
        if not is_plain(name) or len(name) > LONGEST_NAME:
            raise RecipeError(f"{where}: key {key!r}: expected at most {LONGEST_NAME} of {PLAIN}, got {name!r:.120}")
    if not re.fullmatch("[A-Za-z0-9][A-Za-z0-9._-]*", split.version) or len(split.version) > LONGEST_NAME:
        raise RecipeError(
            f"{where}: key 'version': expected a letter or digit, then at most {LONGEST_NAME} of letters, digits, '.', "
            f"'-' and '_', such as 1.0, got {split.version!r:.120}"
        )


def _check_sequence(sequence: SequenceRecipe, where: str) -> None:
    sequence.water.check(where)
    given = [key for key in ("oysters", "density_per_m2") if getattr(sequence.reef, key) is not None]
    if len(given) != 1:
        raise RecipeError(
            f"{where}: keys 'reef.oysters', 'reef.density_per_m2': expected exactly one of them, got "
            f"{' and '.join(given) or 'neither'}"
        )
    check_path(sequence.path, sequence.reef.size_m, where)
    reef, path, site = sequence.reef, sequence.path, sequence.site
    lowest = min(path.altitude_m, path.close_m) if path.kind == "inspection" else path.altitude_m
    moving_water = site.current_m_s > 0 or site.wave_height_m > 0
    check_plumes(sequence.water.plumes, reef.bottom, reef.silt, moving_water, lowest, where)
    if sequence.path.altitude_m >= sequence.reef.depth_m:
        raise RecipeError(
            f"{where}: key 'path.altitude_m': the vehicle would leave the water; expected less than reef.depth_m = "
            f"{sequence.reef.depth_m:g}, got {sequence.path.altitude_m:g}"
        )
    check_life(sequence, where)


def _read_text(path: Path, absent: str) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")  # with or without a byte order mark
    except FileNotFoundError:
        raise RecipeError(absent) from None
    except (OSError, UnicodeDecodeError) as error:
        raise RecipeError(f"{path}: cannot be read: {error}") from None


def _parse_toml(source: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(source)
    except tomllib.TOMLDecodeError as error:
        raise RecipeError(f"{where}: not valid TOML: {error}") from None
