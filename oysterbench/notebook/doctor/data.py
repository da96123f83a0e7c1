"""Checks of the data on this machine, and of its sources: home, splits, trained weights, hub, salts, systems."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from oysterbench.core.disk_space import free_bytes
from oysterbench.core.errors import OysterbenchError
from oysterbench.core.names import counted, did_you_mean, nearest
from oysterbench.core.places import MODELS, home, home_problem, models
from oysterbench.notebook.doctor.finding import Finding, broken_by, in_bytes

HOME, HUB, HUB_KEY, EXPORTS = "OYSTERBENCH_HOME", "OYSTERBENCH_HUB", "OYSTERBENCH_HUB_KEY", "OYSTERBENCH_EXPORTS_GB"
OTHERS = ("OYSTERBENCH_OFFLINE", "OYSTERBENCH_SALT", "OYSTERBENCH_SALT_FILE", "OYSTERBENCH_TOKEN", "OYSTERBENCH_BOARD")
LEAST_FREE = 2e9
"""Free disk space below which a warning is given, bytes: a split of a few dives."""


def look_at_data() -> Iterator[Finding]:
    """Check the home folder and what is in it."""
    yield from _checked("data", "home", _home)
    yield from _splits()
    yield from _checked("data", "trained weights", _weights)
    yield from _checked("data", "exports", _exports)


def _checked(section: str, name: str, look: Callable[..., Iterator[Finding]], *of: object) -> Iterator[Finding]:
    """Yield the findings of a check; an error ends it as a finding of its own."""
    try:
        yield from look(*of)
    except (OysterbenchError, OSError) as error:
        yield broken_by(section, name, error)


def _home() -> Iterator[Finding]:
    folder = home()
    named = f"{folder} ({HOME})" if os.environ.get(HOME) else f"{folder} (the default; {HOME} names another)"
    if problem := home_problem():
        yield Finding("data", "home", "broken", problem, f"let {HOME} name a folder")
        return
    there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        yield Finding("data", "home", "broken", f"{named}: {error.strerror}", f"let {HOME} name a folder of yours")
        return
    free = free_bytes(folder)
    what = named if folder.exists() else f"{named}, made when it is first used"
    little = free < LEAST_FREE
    advice = f"make room, or let {HOME} name another disk" if little else ""
    yield Finding("data", "home", "poor" if little else "ok", f"{what}; {in_bytes(free)} free", advice)


def _splits() -> Iterator[Finding]:
    from oysterbench.recipe import split_names

    known = split_names()
    try:
        names = sorted(path.name for path in (home() / "splits").iterdir() if path.is_dir())
    except OSError:
        names = []
    found = [finding for name in names for finding in _checked("data", name, _split, name, name in known)]
    yield from found
    if not found:
        yield Finding("data", "splits", "missing", "none here yet", "oysterbench render slam-mini")


def _split(name: str, known: bool) -> Iterator[Finding]:
    """Report what is here of a split: sequences of its present version, unfinished renders, and other versions."""
    folder = home() / "splits" / name
    size = {path: path.stat().st_size for path in folder.glob("*/*.mcap")}
    own: list[Path] = []
    detail, advice = f"{counted(len(size), 'file')}, {in_bytes(sum(size.values()))}", ""
    if known:
        from oysterbench.notebook.sources import RecipeSource
        from oysterbench.recipe import load_split

        source = RecipeSource(load_split(name))
        own = [path for sequence in source.names if (path := source.here(sequence)) is not None]
        detail = f"{len(own)} of {len(source.names)} sequences, {in_bytes(sum(size.get(path, 0) for path in own))}"
        if any((source.folder / ".parts").glob("*/*")):
            detail, advice = f"{detail}; a render was begun", f"oysterbench render {name}"
        others = {path: bytes_ for path, bytes_ in size.items() if path not in own}
        if others:
            detail += f"; {len(others)} of other versions, {in_bytes(sum(others.values()))}"
    if size or advice:
        yield Finding("data", name, "ok", detail, advice)


def _weights() -> Iterator[Finding]:
    from oysterbench.hub.settings import hub_places
    from oysterbench.hub.weights import weights_here
    from oysterbench.methods.weights import check_usable, find_weights, usable_path, weights_names, weights_variable

    folder = models()
    if os.environ.get(MODELS) and folder.exists() and not folder.is_dir():
        yield Finding("data", "trained weights", "broken", f"{MODELS} = {folder} is a file", "let it name a folder")
        return
    for name in weights_names():
        variable = weights_variable(name)
        named = os.environ.get(variable)
        path = Path(named) if named else usable_path(name)
        here = weights_here(path)
        if here is None:
            if named:
                yield Finding(
                    "data", f"weights {name}", "broken", f"{variable} = {named}: no such file", f"unset {variable}"
                )
            else:
                known = find_weights(name)
                detail = f"for {', '.join(known.methods)}" if known.methods else known.summary
                advice = f"oysterbench download {name}" if hub_places() else f"oysterbench train {known.train}"
                yield Finding("data", f"weights {name}", "missing", detail, advice)
            continue
        if not named and here.card is None and path.with_suffix(".json").is_file():
            detail = f"{path.with_suffix('.json')}: not a card that can be read"
            yield Finding("data", f"weights {name}", "broken", detail, f"oysterbench download {name} --again")
            continue
        try:
            check_usable(name, path)
        except OysterbenchError as error:
            anew = f"download {name} --again" if here.card else f"train {find_weights(name).train}"
            advice = f"unset {variable}" if named else f"oysterbench {anew}"
            yield broken_by("data", f"weights {name}", error, advice)
            continue
        of = "part of oysterbench" if here.released else "of a hub"
        origin = named or (f"version {here.model.version}, {of}" if here.model else here.brief)
        yield Finding("data", f"weights {name}", "ok", f"{in_bytes(path.stat().st_size)}, {origin}")


def _exports() -> Iterator[Finding]:
    text = os.environ.get(EXPORTS)
    if text:
        try:
            yield Finding("data", "exports", "ok", f"up to {max(0.0, float(text)):g} GB are kept ({EXPORTS})")
        except ValueError:
            detail = f"{EXPORTS}: expected the maximum size of exports in GB, got {text!r}"
            yield Finding("data", "exports", "broken", detail, f"{EXPORTS}=20")


def look_at_hub() -> Iterator[Finding]:
    """Check the hub that is set, its key, and the other environment variables. No network is used."""
    yield from _checked("hub", "hub", _hub)
    yield from _checked("hub", "key", _key)
    yield from _checked("hub", "salt", _salt)
    yield from _variables()


def _hub() -> Iterator[Finding]:
    from oysterbench.hub.settings import hub_places
    from oysterbench.hub.sources import is_offline

    places = hub_places()
    if not places:
        advice = f"{HUB}=https://..., or url in {home() / 'hub.toml'}"
        yield Finding("hub", "hub", "missing", "none is set: splits are rendered instead, the same bytes", advice)
    for place in places:
        if is_offline() and place.lower().startswith(("http://", "https://")):
            detail = f"{place}: not asked while OYSTERBENCH_OFFLINE is set"
            yield Finding("hub", "hub", "poor", detail, "unset OYSTERBENCH_OFFLINE")
            continue
        yield from _checked("hub", "hub", _place, place)


def _place(place: str) -> Iterator[Finding]:
    from oysterbench.hub.sources import open_source

    name = open_source(place).name
    yield Finding("hub", "hub", "ok", f"{name}; `oysterbench splits --hub` asks it what it has")


def _key() -> Iterator[Finding]:
    from oysterbench.hub.settings import hub_key, hub_places

    key = hub_key()
    if key is not None:
        yield Finding("hub", "key", "ok", f"{key[:16]}…")
    elif hub_places():
        detail = "no public key of the hub is set: only releases that came with oysterbench are taken from it"
        yield Finding("hub", "key", "poor", detail, f"{HUB_KEY}=..., which the hub's owner has")


def _salt() -> Iterator[Finding]:
    from oysterbench.simulation.salt import read_salt

    if read_salt() is not None:
        yield Finding("hub", "salt", "ok", "a salt of hidden splits is set")


def _variables() -> Iterator[Finding]:
    """Report variables that nothing reads, most likely misspelled."""
    from oysterbench.methods.weights import weights_names, weights_variable

    prefix = "OYSTERBENCH_"
    known = [HOME, HUB, HUB_KEY, EXPORTS, MODELS, *OTHERS, *map(weights_variable, weights_names())]
    for name in sorted(os.environ):
        meant = nearest(name.removeprefix(prefix), [one.removeprefix(prefix) for one in known])[:1]
        if name.startswith(prefix) and name not in known and meant:
            yield Finding("hub", name, "poor", f"nothing reads it; {did_you_mean([prefix + meant[0]])}".rstrip())


def look_at_systems() -> Iterator[Finding]:
    """Check which published systems are built."""
    from oysterbench.methods.systems import systems
    from oysterbench.methods.systems.building import built

    for system in systems().values():
        described = system.description
        try:
            build = built(system)
        except OSError:  # the home folder is unusable, which is reported separately
            build = None
        except OysterbenchError as error:
            yield broken_by("systems", system.name, error, f"oysterbench systems build {system.name} --again")
            continue
        if build is not None:
            yield Finding("systems", system.name, "ok", f"{described.title}, built, {in_bytes(build.size_bytes)}")
            continue
        takes = f"{described.cpu_minutes:g} min of processor time, {in_bytes(1e6 * described.disk_mb)}"
        detail = f"{described.title}, not built: takes {takes}"
        yield Finding("systems", system.name, "missing", detail, f"oysterbench systems build {system.name}")
