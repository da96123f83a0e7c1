"""Categories of COCO files: which are of oysters, and alive or dead, by their names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

OYSTERS = frozenset(("oyster", "oysters"))
STATES = frozenset(("live", "dead"))


@dataclass(frozen=True)
class Categories:
    """Categories of a file. names: of all, by id; states: live, dead or unknown, of those of oysters, by id; doubtful:
    ids of those that may be of oysters or not."""

    names: Mapping[Any, str]
    states: Mapping[Any, str]
    doubtful: frozenset[Any]


def categories_of(content: list[Any], oysters_alone: bool = False) -> Categories:
    """Read the list of categories of a file. oysters_alone: of one about nothing else, whatever categories it lists.

    Oysters are those named oyster or oysters, alone or with live or dead, in any case and order; live or dead alone,
    too, if the supercategory is oysters, or the file has no others, but for one above all, as Roboflow writes, or is
    about oysters alone, unless oysters beside them have another supercategory. Elsewhere these are doubtful, and so are
    others with the supercategory of oysters, as a project called oysters may have anything below it, unless oysters
    have a category of their own beside them.
    """
    known = [one for one in content if isinstance(one, dict)]
    names = {one.get("id"): str(one.get("name")) for one in known}
    groups = {one.get("id"): str(one.get("supercategory")) for one in known}
    states = {number: _state(name) for number, name in names.items() if _only(name, OYSTERS | STATES, OYSTERS)}
    bare = {number for number, name in names.items() if _only(name, STATES, STATES)}
    own = {groups[number] for number in states}  # groups in which oysters have a category of their own
    within = {k for k, group in groups.items() if k not in states and _only(group, OYSTERS, OYSTERS)}
    below = Counter(groups.values())
    whole = {k for k, name in names.items() if below[name] - (groups[k] == name) == len(names) - 1}
    alone = names.keys() - whole <= bare | states.keys()
    known_groups = own | {names[k] for k in whole}
    alike = {k for k in bare if groups[k] in known_groups or _words(groups[k]) <= OYSTERS | STATES | {"none"}}
    if alone or oysters_alone:
        within |= alike if states or not alone else bare
    states |= {number: _state(names[number]) for number in bare & within}
    doubtful = (bare | {number for number in within if groups[number] not in own}) - states.keys()
    return Categories(names, states, frozenset(doubtful))


def _only(name: str, known: frozenset[str], wanted: frozenset[str]) -> bool:
    """Whether a name has no other words than known ones, and one that is wanted."""
    words = _words(name)
    return words <= known and bool(words & wanted)


def _words(name: str) -> set[str]:
    return set(re.split(r"[\W_]+", name.casefold())) - {""}


def _state(name: str) -> str:
    said = _words(name) & STATES
    return said.pop() if len(said) == 1 else "unknown"
