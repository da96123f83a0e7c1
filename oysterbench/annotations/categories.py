"""Categories of COCO files and classes of YOLO sets: which are of oysters, and alive or dead, by their names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

OYSTERS = frozenset(("oyster", "oysters"))
STATES = frozenset(("live", "dead"))
UNSURE = ("alive", "living", "dying", "recently", "unknown", "undefined", "unsure", "uncertain", "unidentified")
AGES = ("spat", "juvenile", "juveniles", "adult", "adults")
DOUBTFUL = STATES.union(UNSURE, AGES)
"""Words of which a name alone, numbers aside, may be of oysters or of anything else."""
KINDS = (
    "object",
    "objects",
    "thing",
    "things",
    "type",
    "class",
    "category",
    "label",
    "labels",
    "name",
    "status",
    "state",
)
NOTHING = frozenset(("null", "na", "n", "a", "default", "undefined", "root", *KINDS))
"""Words of supercategories that programs write where none was given, or by which VIA divides objects: they are of
nothing."""
ELSE = frozenset(
    (
        *("fish", "finfish", "goby", "blenny", "toadfish", "sculpin", "eel", "shark", "ray", "skate"),
        *("salmon", "turtle", "mammal", "seal", "dolphin", "otter", "diver", "human", "person", "star"),
        *("bird", "crab", "shrimp", "prawn", "lobster", "crayfish", "crustacean", "amphipod", "isopod", "barnacle"),
        *("mussel", "clam", "cockle", "scallop", "snail", "gastropod", "whelk", "limpet", "conch", "chiton", "slug"),
        *("squid", "octopus", "cephalopod", "starfish", "urchin", "cucumber", "echinoderm", "anemone", "jellyfish"),
        *("coral", "hydroid", "bryozoan", "tunicate", "ascidian", "sponge", "worm", "polychaete", "alga", "algae"),
        *("macroalga", "macroalgae", "macrophyte", "seaweed", "kelp", "seagrass", "eelgrass", "plant", "vegetation"),
        *("rock", "stone", "sand", "mud", "sediment", "debris", "litter", "trash", "vehicle"),
        *("background", "void", "equipment"),
    )
)
"""Words of supercategories that are of no oysters, for certain: animals, plants and things on and around oyster reefs,
by the names of their kinds in English. Groups that hold oysters, such as bivalves, shellfish or molluscs, are none of
them, nor are ages, or what else objects are divided by."""


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
    too, if their supercategory is oysters; or, where the file has no others but one above all, as Roboflow writes, or
    is about oysters alone, if it has this word among others, says nothing, or is that of oysters beside them. Elsewhere
    these are doubtful, and so are all other names that have the word oyster, such as juvenile oyster, or are a state
    alone (`DOUBTFUL`), though not the ages, or what is not known, of something `ELSE`, as of fish; and what has the
    supercategory oysters, as a project of this name may have anything below it, unless oysters have a category of their
    own beside it.
    """
    known = [one for one in content if isinstance(one, dict)]
    names = {one.get("id"): str(one.get("name")) for one in known}
    groups = {one.get("id"): str(one.get("supercategory") or "") for one in known}
    below = Counter(groups.values())
    whole = {k for k, name in names.items() if below[name] - (groups[k] == name) == len(names) - 1}
    words, above = ({k: _words(name) for k, name in of.items()} for of in (names, groups))
    oysters = {k for k, said in words.items() if said & OYSTERS and said <= OYSTERS | STATES}
    bare = {k for k, said in words.items() if said and said <= STATES}
    own = {groups[k] for k in oysters}  # groups in which oysters have a category of their own
    within = {k for k in names.keys() - oysters if above[k] and above[k] <= OYSTERS}
    found = oysters | (bare & within)
    if oysters_alone or names.keys() - whole <= bare | oysters:
        none = STATES | {"none"} | (frozenset() if oysters else NOTHING)
        found |= {k for k in bare if groups[k] in own or above[k] & OYSTERS or above[k] <= none}
    elsewhere = {k for k in names if groups[k] not in own and not above[k] & OYSTERS and _of_something_else(above[k])}
    named = {k for k, name in names.items() if may_be_oysters(name)}
    named -= {k for k in elsewhere if not words[k] & (OYSTERS | STATES)}
    doubtful = (named | {k for k in within if groups[k] not in own}) - found
    return Categories(names, {k: _state(words[k]) for k in found}, frozenset(doubtful))


def may_be_oysters(name: str) -> bool:
    """Whether a name has the word oyster, among any others or in one with them, or says a state and not of what."""
    said = set(re.findall(r"[^\W\d_]+", _apart(name).casefold()))
    return "oyster" in name.casefold() or bool(said and said <= DOUBTFUL)


def _of_something_else(words: set[str]) -> bool:
    return any(ELSE & {word, word.removesuffix("s"), word.removesuffix("es")} for word in words)


def _words(name: str) -> set[str]:
    return set(re.split(r"[\W_]+", _apart(name).casefold())) - {""}


def _apart(name: str) -> str:
    """A name with spaces between words that are joined, as in DeadOyster."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)


def _state(words: set[str]) -> str:
    said = words & STATES
    return said.pop() if len(said) == 1 else "unknown"
