"""Opening all of it: what `oysterbench leaderboard serve --submissions FOLDER --truth SPLIT=FOLDER` stands on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.store import RecordStore
from oysterbench_leaderboard.submissions.catalogue import TRACKS_OF, Catalogue, Served, serve_split
from oysterbench_leaderboard.submissions.service import Service
from oysterbench_leaderboard.submissions.settings import load_settings


def open_service(
    folder: Path, truths: Iterable[str], store: RecordStore, changed: Callable[[], None] = lambda: None
) -> Service:
    """The service of a private folder. truths: SPLIT=FOLDER, of hidden splits and of public ones that are kept
    elsewhere; SPLIT is a name, or a recipe (.toml). changed: called when a record came onto the board, or off it.

    Every public split is served: its estimates are scored where it is rendered here, and its results are taken.
    Raises ResultError where a truth is missing, or of another split.
    """
    settings = load_settings(folder)
    return Service(settings, served_splits(truths, folder / "catalogue"), store, changed)


def served_splits(truths: Iterable[str], cache: Path | None = None) -> Catalogue:
    """What there is to be served."""
    from oysterbench.recipe import load_split, split_names

    found: dict[str, Served] = {}
    for given in truths:
        split, _, place = given.partition("=")
        if not split or not place:
            raise ResultError(f"--truth: expected SPLIT=FOLDER, got {given!r}")
        served = serve_split(split, Path(place), cache)
        found[served.any.split] = served
    for name in split_names():
        recipe = load_split(name)
        if name not in found and not recipe.hidden and recipe.track in TRACKS_OF:
            found[name] = serve_split(name, None, cache)
    return Catalogue(found.values())
