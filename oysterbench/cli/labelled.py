"""Labelled data as an argument of commands: a path, or the name of a split, which is rendered if it is missing."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oysterbench.core.errors import LabelError

if TYPE_CHECKING:
    from oysterbench.annotations import LabelledSet


class LabelledData(click.ParamType):  # type: ignore[type-arg]
    """Option type for labelled data; a name that does not exist is refused before anything heavy is loaded."""

    name = "SPLIT|PATH"

    def convert(self, value: str, param: click.Parameter | None, context: click.Context | None) -> str:
        """Check the name, and return it as it was typed."""
        check_data(value)
        return value


LABELLED = LabelledData()


def check_data(name: str) -> None:
    """Refuse a name that is neither a split, a recipe nor an existing path. Raises LabelError."""
    from oysterbench.core.names import did_you_mean, nearest
    from oysterbench.recipe.split import split_names

    known = split_names()
    if name not in known and not name.endswith(".toml") and not Path(name).exists():
        meant = did_you_mean(nearest(name, known))
        raise LabelError(f"{name}: no split, file or folder of that name; {meant}`oysterbench splits` lists splits")


def open_data(name: str) -> LabelledSet:
    """Open the labelled images of a split, of a recipe (.toml), or at a path (`annotations.opening.KINDS`)."""
    from oysterbench.annotations import open_labelled
    from oysterbench.recipe import load_split, split_names

    check_data(name)
    if name not in split_names() and not name.endswith(".toml"):
        return open_labelled(name)
    from oysterbench.annotations.sequences import sequence_set
    from oysterbench.cli.render import render_files
    from oysterbench.simulation.conditions import conditions

    split = load_split(name)
    files = render_files(split)
    return sequence_set(split.name, files.values(), {key: conditions(split, key) for key in files})


def named_places(texts: Sequence[str], taken: Collection[str]) -> dict[str, list[str]]:
    """Parse options --synthetic NAME=SPLIT|PATH to name -> splits or paths. taken: names with another meaning."""
    found: dict[str, list[str]] = {}
    for text in texts:
        name, place = _named(text, "--synthetic", "NAME=SPLIT or NAME=PATH", taken)
        check_data(place)
        found.setdefault(name, []).append(place)
    return found


def named_files(texts: Sequence[str], taken: Collection[str]) -> dict[str, Path]:
    """Parse options --weights NAME=MODEL|FILE to name -> file. taken: names with another meaning."""
    found: dict[str, Path] = {}
    for text in texts:
        name, place = _named(text, "--weights", "NAME=MODEL|FILE", [*taken, *found])
        found[name] = Path(place)
    return found


def _named(text: str, option: str, form: str, taken: Collection[str]) -> tuple[str, str]:
    """Split an option NAME=PLACE into name and place. Raises click.UsageError for another form or a taken name."""
    name, equals, place = text.partition("=")
    if not equals or not name.replace("-", "").replace("_", "").isalnum() or name in taken:
        raise click.UsageError(f"{option}: expected {form}, with a name other than {', '.join(taken)}, got {text!r}")
    return name, place


def open_all(names: Sequence[str], name: str = "") -> LabelledSet:
    """Open several data sets as one set."""
    return _as_one([open_data(one) for one in names], name)


def open_training_data(names: Sequence[str], side: str | None = None, name: str = "") -> LabelledSet:
    """Open several data sets as one set to train on, called `name`. Of one that has sides, only `side` is used
    (`training_side`); one without sides is used whole. Raises LabelError where a set that has sides, or every set,
    lacks that which was asked for."""
    sets = [open_data(one) for one in names]
    sided = any(one.splits for one in sets)
    return _as_one([one if sided and not one.splits else training_side(one, side) for one in sets], name)


def training_side(labelled: LabelledSet, side: str | None = None) -> LabelledSet:
    """Select the images of a set to learn from: those of `side`, by default train, or where there is none all but test;
    without sides all. Where only some images have a side, the others are on none. What is left out is said. Raises
    LabelError where there is no side that was asked for."""
    from oysterbench.annotations.manifest import TEST, TRAIN
    from oysterbench.cli.echo import message

    sides = {entry.split for entry in labelled.entries}
    if side is None and (sides <= {""} or sides == {TRAIN}):
        return labelled
    if side is None and TRAIN not in labelled.splits:
        # What is scored is not learnt from, unless there is nothing else.
        chosen = labelled.where(lambda entry: entry.split != TEST)
        used = f"{len(chosen)} of {len(labelled)} images are used, all but the side {TEST}"
        if len(chosen) in (0, len(labelled)):
            chosen, used = labelled, "all images are used"
        message(f"{labelled.name}: {used}: there is no side {TRAIN}, but {', '.join(labelled.splits)}")
        return chosen
    chosen = labelled.of_split(side or TRAIN)
    message(f"{labelled.name}: {len(chosen)} of {len(labelled)} images are used, the side {side or TRAIN}")
    return chosen


def _as_one(sets: Sequence[LabelledSet], name: str = "") -> LabelledSet:
    from oysterbench.annotations import joined

    return sets[0] if len(sets) == 1 else joined(sets, name or "+".join(one.name for one in sets))
