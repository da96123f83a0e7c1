"""A split, opened by its name: its sequences, each rendered or downloaded on first use."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from oysterbench.core.errors import SequenceError
from oysterbench.core.names import instead
from oysterbench.notebook.progress import frames_bar
from oysterbench.notebook.rendering import check_renderer
from oysterbench.notebook.sources import RecipeSource, Source, find_source
from oysterbench.sequence.types import Sequence

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from numpy.typing import NDArray

    from oysterbench.annotations import LabelledSet
    from oysterbench.recipe import SplitRecipe

ON_A_CARD = ("duration_s", "difficulty", "water_type", "secchi_m", "light", "density", "motion", "size_mb", "here")
"""Columns of `Split.summary` that a card shows."""


class Split:
    """The sequences of a split, in order; each is rendered or downloaded on first use, and opened anew each time.

    Attributes
    ----------
    name, version, track : str
        Those of the split; version and track are empty where only a folder of files is known.
    about : str
        Description of the split, in a sentence.
    names : tuple of str
        Names of its sequences, in order.
    recipe : SplitRecipe or None
        Recipe that it is rendered from; None where only its files are known.

    Examples
    --------
    >>> import oysterbench
    >>> split = oysterbench.split("slam-val")
    >>> len(split), split.names[0]
    (8, 'val-01')
    >>> split[1:3].names
    ('val-02', 'val-03')

    Sequences are indexed by number or by name, and are rendered, or downloaded where a hub is set, on first use, as in
    `oysterbench.split("slam-mini")["mini-01"]`. A folder of sequence files is a split, too:

    >>> for sequence in oysterbench.split("."):
    ...     print(sequence.name, len(sequence.cameras))
    hand-made 2
    """

    def __init__(
        self, source: Source, names: tuple[str, ...] | None = None, workers: int | None = None, quiet: bool = False
    ) -> None:
        self._source, self._workers, self._quiet = source, workers, quiet
        self.names = source.names if names is None else names

    @property
    def name(self) -> str:
        """Name of the split."""
        return self._source.name

    @property
    def version(self) -> str:
        """Version of the split; empty for a folder."""
        return self._source.version

    @property
    def track(self) -> str:
        """Track that the split is made for; empty for a folder."""
        return self._source.track

    @property
    def about(self) -> str:
        """Description of the split, in a sentence."""
        return self._source.about

    @property
    def recipe(self) -> SplitRecipe | None:
        """Recipe that the split is rendered from; None where only its files are known."""
        return self._source.recipe

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[Sequence]:
        return (self[name] for name in self.names)

    @overload
    def __getitem__(self, which: int | str) -> Sequence: ...

    @overload
    def __getitem__(self, which: slice) -> Split: ...

    def __getitem__(self, which: int | str | slice) -> Sequence | Split:
        """Open a sequence by its number or name, rendered or downloaded if missing; or take a slice of the split."""
        if isinstance(which, slice):
            return Split(self._source, self.names[which], self._workers, self._quiet)
        from oysterbench.sequence import open_sequence

        name = self._name(which)
        return open_sequence(self.fetch(name)[name])

    def _name(self, which: int | str) -> str:
        if isinstance(which, str):
            if which not in self.names:
                listed_by = f"oysterbench splits {self.name}"
                raise SequenceError(f"{self.name} has no sequence {which!r}; {instead(which, self.names, listed_by)}")
            return which
        if not -len(self) <= which < len(self):
            raise IndexError(f"{self.name} has {self._count}, from 0 on; got number {which}")
        return self.names[which]

    def fetch(self, *names: str, workers: int | None = None) -> dict[str, Path]:
        """Get the files that are not here yet, of all sequences by default, and return their paths.

        They are rendered, or downloaded where a hub is set. What was interrupted, even by a kill, is resumed.

        Parameters
        ----------
        *names : str
            Names of sequences; all by default.
        workers : int, optional
            Processes that render; one per core by default.

        Returns
        -------
        dict of str to pathlib.Path
            Sequence -> file.

        Raises
        ------
        oysterbench.OysterbenchError
            There is no such sequence, no disk space, no network, or no renderer.
        """
        wanted = [self._name(name) for name in names or self.names]
        missing = [name for name in wanted if self._source.here(name) is None]
        if missing:
            self._source.get(missing, workers or self._workers, self._quiet)
        paths = {name: self._source.here(name) for name in wanted}
        return {name: path for name, path in paths.items() if path is not None}

    @property
    def here(self) -> dict[str, Path]:
        """Sequence -> file, for those that are on this machine."""
        paths = {name: self._source.here(name) for name in self.names}
        return {name: path for name, path in paths.items() if path is not None}

    def summary(self) -> pd.DataFrame:
        """Table of the conditions of each sequence, one row each; nothing is rendered or downloaded for it.

        Returns
        -------
        pandas.DataFrame
            Indexed by the name of the sequence. Conditions with the unit in the name (those of
            `oysterbench.evaluate.conditions.CONDITIONS`): duration_s, secchi_m, water_type, ...; size_mb of the file
            (NaN until known); here, whether it is on this machine. For a folder, only what its files contain.

        Examples
        --------
        >>> import oysterbench
        >>> oysterbench.split("slam-mini").summary().loc["mini-01", "duration_s"].item()
        20.0
        """
        import pandas as pd

        rows = []
        for name in self.names:
            size, path = self._source.size_bytes(name), self._source.here(name)
            known = {"size_mb": float("nan") if size is None else size / 1e6, "here": path is not None}
            rows.append({**self._conditions(name, path), **known})
        return pd.DataFrame(rows, index=pd.Index(self.names, name="sequence"))

    def _conditions(self, name: str, path: Path | None) -> dict[str, Any]:
        if self.recipe is not None:
            from oysterbench.simulation.conditions import conditions

            return {"duration_s": self.recipe.find_sequence(name).duration_s, **conditions(self.recipe, name)}
        if path is None:
            return {}
        from oysterbench.sequence import open_sequence

        sequence = open_sequence(path)
        return {"duration_s": sequence.duration_s, "cameras": len(sequence.cameras)}

    def preview(self, name: str | None = None) -> NDArray[np.uint8]:
        """Render a sheet of small frames of a sequence in seconds, to see a recipe before it is rendered in full.

        Parameters
        ----------
        name : str, optional
            Name of the sequence; the first by default.

        Returns
        -------
        (H, W, 3) array of uint8
            RGB; frames evenly spaced over the sequence, each above its camera and time.

        Raises
        ------
        oysterbench.core.errors.SequenceError
            There is no such sequence, or only files are known and no recipe.
        """
        from oysterbench.simulation.gallery import preview

        if self.recipe is None:
            raise SequenceError(f"{self.name}: it has files but no recipe: there is nothing to preview")
        check_renderer(f"{self.name}:")
        shown = self._name(self.names[0] if name is None else name)
        with nullcontext(lambda done, total: None) if self._quiet else frames_bar(f"previewing {shown}") as progress:
            return preview(self.recipe, shown, progress)

    def labelled(self) -> LabelledSet:
        """Labelled images of all sequences, each read on demand.

        Raises
        ------
        oysterbench.core.errors.LabelError
            No camera of the split has the layers class and instance.
        """
        from oysterbench.annotations.sequences import sequence_set

        paths = list(self.fetch().values())
        known = {} if self.recipe is None else {name: self._conditions(name, None) for name in self.names}
        return sequence_set(self.name, paths, known)

    def __repr__(self) -> str:
        return f"<Split {self._title}: {self._outline}>"

    def _repr_html_(self) -> str:
        from oysterbench.core.display import CardTable, card

        table = self.summary()
        shown = [column for column in ON_A_CARD if column in table]
        values = table[shown].itertuples(index=False)
        rows = [(name, *map(_cell, row)) for name, row in zip(table.index, values, strict=True)]
        parts = [CardTable(("sequence", *shown), rows)]
        return card(self._title, f"{self.about} ({self._outline})" if self.about else self._outline, parts)

    @property
    def _title(self) -> str:
        return f"{self.name} {self.version}".strip()

    @property
    def _outline(self) -> str:
        here = self.here
        size = sum(path.stat().st_size for path in here.values())
        state = (
            f"{'all' if len(here) == len(self) else len(here)} here, {size / 1e6:.0f} MB" if here else "none here yet"
        )
        return ", ".join([*([self.track] if self.track else []), self._count, state])

    @property
    def _count(self) -> str:
        return f"{len(self)} sequence{'' if len(self) == 1 else 's'}"

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.names)


def split(name: str | os.PathLike[str], *, workers: int | None = None, quiet: bool = False) -> Split:
    """Open a split by its name; its files are rendered, or downloaded where a hub is set, on first use. Those of a
    recipe of your own are always rendered.

    Parameters
    ----------
    name : str or path
        A name of `oysterbench.splits()`, or NAME@VERSION of a hub; the path of a recipe (.toml); or a folder of
        sequence files.
    workers : int, optional
        Processes that render; one per core by default.
    quiet : bool
        Show no progress.

    Returns
    -------
    Split
        Supports `len`, iteration, `[0]`, `["val-01"]`, `[1:3]`; `summary()` is a table; `fetch()` gets all files.

    Raises
    ------
    oysterbench.core.errors.RecipeError
        No split of this name is known.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.split("seg-mini").names
    ('mini-01', 'mini-02')
    >>> oysterbench.split("seg-minni")                   # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    oysterbench.core.errors.RecipeError: unknown split 'seg-minni'; did you mean seg-mini or ...
    """
    return Split(find_source(Path(name) if isinstance(name, os.PathLike) else name), workers=workers, quiet=quiet)


def splits() -> pd.DataFrame:
    """Table of the splits that come with oysterbench, one row each; nothing is rendered for it.

    Returns
    -------
    pandas.DataFrame
        Indexed by name: version, track, sequences, duration_s, here (number of sequences on this machine), hidden
        (whether the ground truth is withheld), about.

    Examples
    --------
    >>> import oysterbench
    >>> table = oysterbench.splits()
    >>> table.loc["slam-mini", "track"], table.loc["slam-mini", "sequences"].item()
    ('slam', 1)
    """
    import pandas as pd

    from oysterbench.recipe import load_split, split_names

    rows = []
    for recipe in map(load_split, split_names()):
        rows.append(
            {
                "version": recipe.version,
                "track": recipe.track,
                "sequences": len(recipe.sequence),
                "duration_s": sum(sequence.duration_s for sequence in recipe.sequence),
                "here": len(Split(RecipeSource(recipe)).here),
                "hidden": recipe.hidden,
                "about": recipe.summary,
            }
        )
    return pd.DataFrame(rows, index=pd.Index(split_names(), name="split"))


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "" if value != value else f"{value:.4g}"
    return str(value)
