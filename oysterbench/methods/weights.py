"""Trained weights that methods use: what is known about them, how to get them, and fetching them before a run.

A method that uses weights declares them in an attribute `weights`, name -> file:

    @property
    def weights(self):
        return {"my_net": Path(self.checkpoint) if self.checkpoint else usable_path("my_net")}

The entry-point group `oysterbench.weights` provides what is known about weights, by their name.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from oysterbench.core.errors import HubError, MethodError
from oysterbench.core.names import instead
from oysterbench.core.places import models, released_models
from oysterbench.hub.manifest import LICENCE
from oysterbench.hub.model import Model, Training
from oysterbench.methods.code import file_digest

ENTRY_POINTS = "oysterbench.weights"

Announce = Callable[[str], None]
Bar = Callable[[str, str], AbstractContextManager[Callable[[int, int], None]]]
"""Called with a title and a unit; its context gives a function (done, total) that shows progress."""


@dataclass(frozen=True)
class Weights:
    """What is known about trained weights, whether or not they are here.

    name:     the name in `oysterbench train` and `oysterbench download`
    methods:  methods that use them
    train:    arguments of the `oysterbench train` that makes them
    takes:    how long training takes, and on what, in words
    option:   option by which a user names a file of other weights
    summary:  what they are, in one line; limits: what they are not suited for, in sentences; licence: a URL
    describe: reads how the weights in a file were trained; raises MethodError where the file is not one of these
              weights, or training did not finish
    check:    raises MethodError where methods refuse a file: it is damaged, or training did not finish
    """

    name: str
    methods: tuple[str, ...]
    train: str
    takes: str
    option: str
    summary: str
    limits: str
    describe: Callable[[Path], Training]
    licence: str = LICENCE
    check: Callable[[Path], object] = lambda path: None


def weights_path(name: str) -> Path:
    """Path where `oysterbench train NAME` and `oysterbench download NAME` save weights."""
    return models() / f"{name}.pt"


def usable_path(name: str) -> Path:
    """Path of the weights that methods use by default: those trained or downloaded here or else, if there are any,
    those that are part of oysterbench."""
    own, released = weights_path(name), released_models() / f"{name}.pt"
    return released if released.is_file() and not own.is_file() else own


def used_path(name: str) -> Path:
    """Path of the weights that methods use, unless a method is given others: those that OYSTERBENCH_<NAME> names, or by
    default `usable_path`."""
    return Path(os.environ.get(weights_variable(name)) or usable_path(name))


def weights_variable(name: str) -> str:
    """Environment variable by which a user names a file of other weights, whatever its suffix."""
    return f"OYSTERBENCH_{name.upper()}"


def weights_names() -> list[str]:
    """Names of the known weights."""
    return sorted(point.name for point in entry_points(group=ENTRY_POINTS))


def find_weights(name: str) -> Weights:
    """Look up weights by name. Raises MethodError where they are unknown."""
    found = entry_points(group=ENTRY_POINTS, name=name)
    if not found:
        raise MethodError(
            f"no trained weights are called {name!r}; {instead(name, weights_names(), 'oysterbench models')}"
        )
    point = next(iter(found))
    try:
        weights = point.load()
    except ImportError as error:
        raise MethodError(f"weights {name!r}: {error}; install what they need") from None
    if not isinstance(weights, Weights):
        raise MethodError(f"weights {name!r}: expected {Weights.__qualname__}, got {type(weights)}")
    return weights


def weights_of(method: Any) -> dict[str, Path]:
    """Files of the trained weights that a method uses, by name; empty for most methods."""
    return {str(name): Path(path) for name, path in dict(getattr(method, "weights", {})).items()}


def weights_digests(needed: Mapping[str, Path]) -> dict[str, str]:
    """SHA-256 of each file; an empty string if it is absent."""
    return {name: file_digest(path) if path.is_file() else "" for name, path in needed.items()}


def existing(name: str, path: Path) -> Path:
    """Return the path of weights if the file exists. Raises MethodError, with what to type, where it does not."""
    if not path.is_file():
        raise no_weights(name, path)
    return path


def no_weights(name: str, path: Path) -> MethodError:
    """Error for missing weights, with what to type if they are known."""
    try:
        known = find_weights(name)
    except MethodError:
        return MethodError(f"{name}: no trained weights at {path}")
    return MethodError(
        f"{name}: no trained weights at {path}: `oysterbench train {known.train}` trains them on your machine "
        f"({known.takes}), `oysterbench download {name} --from URL --key KEY` downloads them from a hub; name others "
        f"with {known.option} or {weights_variable(name)}"
    )


def card_of(name: str, path: Path) -> Model | None:
    """Card beside weights, of this very file; None where there is none. Raises MethodError where it says that they are
    others than those of this name."""
    from oysterbench.hub.weights import weights_here

    here = weights_here(path)
    model = None if here is None else here.model
    if model is not None and model.name != name:
        raise MethodError(
            f"{path}: expected weights of {name}, got {model.name} {model.version}, as the card beside them says"
        )
    return model


def check_usable(name: str, path: Path) -> None:
    """Raise MethodError where methods refuse the file of known weights, such as one of an interrupted training, or of
    others (`card_of`). Files of which a card beside them is, which were released, are not read, and none are where what
    reads them is not installed."""
    if name in weights_names() and card_of(name, path) is None:
        with suppress(ModuleNotFoundError):
            find_weights(name).check(path)


def have_weights(
    needed: Mapping[str, Path],
    announce: Announce = lambda text: None,
    bar: Bar = lambda title, unit: nullcontext(lambda done, total: None),
) -> None:
    """Make sure that weights are here before a method uses them: missing ones are fetched if a hub is set.

    Raises MethodError, with what to type, where weights are missing and no hub is set or the user named another file,
    or where they cannot be used (`check_usable`); HubError, with the same and the reason, where the hub does not
    provide them.
    """
    for name, path in needed.items():
        if path.is_file():
            check_usable(name, path)
            continue
        absent = no_weights(name, path)
        if path.absolute() != weights_path(name):
            raise absent
        try:
            fetched = _fetched(name, path, announce, bar)
        except HubError as error:
            raise type(error)(f"{absent}; from the hub: {error}") from None
        if not fetched:
            raise absent


def _fetched(name: str, path: Path, announce: Announce, bar: Bar) -> bool:
    """Fetch weights from the hub. Returns False if no hub is set."""
    from oysterbench.hub.download import Hub
    from oysterbench.hub.settings import hub_key, hub_places
    from oysterbench.hub.weights import fetch_weights

    places = hub_places()
    if not places:
        return False
    hub = Hub.at(places, hub_key(), announce)
    model = hub.model(name)
    announce(f"{name}: no trained weights here; downloading {hub.described(model)}")
    with bar(f"fetching {name}", "kB") as progress:
        fetch_weights(hub, model, path, progress=lambda done, total: progress(done // 1000, total // 1000))
    return True
