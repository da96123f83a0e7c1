"""Which hub, and whose key. In order of precedence: options, environment, the user's file, oysterbench's own file."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from importlib import resources
from typing import Any

from oysterbench.core.errors import HubError
from oysterbench.core.places import home
from oysterbench.hub.sign import check_public

FILE = "hub.toml"
"""File in the home folder, or with oysterbench's splits: `url` (an address or a list of mirrors) and `key`."""

NO_HUB = "no hub is set (--from, OYSTERBENCH_HUB or hub.toml in the home folder)"

NAME_ONE = "name one, with its public key: --from URL --key KEY"


def hub_places(given: Sequence[str] = ()) -> list[str]:
    """Addresses or folders of the hub's mirrors; none where no hub is set."""
    if named := [place for place in given if place.strip()]:  # an empty one, as from an unset variable, is ignored
        return named
    if named := os.environ.get("OYSTERBENCH_HUB", "").split():
        return named
    url = _file().get("url", [])
    places = [url] if isinstance(url, str) else url
    if not isinstance(places, list) or not all(isinstance(place, str) for place in places):
        raise HubError(f"{FILE}: key 'url': expected an address or a list of them, got {url!r}")
    return [place for place in places if place]


def hub_key(given: str | None = None) -> str | None:
    """The pinned public key in hex, or None."""
    if given and given.strip():
        return check_public(given, "--key")
    if named := os.environ.get("OYSTERBENCH_HUB_KEY", "").strip():
        return check_public(named, "OYSTERBENCH_HUB_KEY")
    key = _file().get("key")
    return check_public(str(key), f"{FILE}: key 'key'") if key else None


def _file() -> dict[str, Any]:
    for place in (home() / FILE, resources.files("oysterbench_datasets") / FILE):
        if not place.is_file():
            continue
        try:
            return tomllib.loads(place.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise HubError(f"{place}: not valid TOML: {error}") from None
    return {}
