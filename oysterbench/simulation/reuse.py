"""Topics that files rendered earlier already have: cut from one that has all, or taken for a file that needs more."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path

from oysterbench.core.errors import SequenceError
from oysterbench.core.names import listed
from oysterbench.recipe import SequenceRecipe, SplitRecipe
from oysterbench.sequence.cut import cut_to, smaller_files
from oysterbench.sequence.read import McapSequence
from oysterbench.simulation.generate import check_made_by, digest, is_whole, sequence_files, split_folder
from oysterbench.simulation.jobs import sources, wanted_sensors, wanted_topics

Taken = dict[str, dict[str, Path]]
"""Sequence -> topic -> file that has its messages."""


def reuse(
    split: SplitRecipe,
    folder: Path,
    missing: Iterable[SequenceRecipe],
    topics: Collection[str],
    salt: bytes = b"",
    tell: Callable[[str], None] = lambda line: None,
) -> Taken:
    """Make smaller files with these topics in `folder`, of the sequences of which a complete or smaller file under the
    home folder has all of them: rendering them again would take much longer.

    Returns, of the other sequences, the topics of cameras and sonars that smaller files have. tell: called with a line
    for the user: what comes from where, and which file is damaged and passed over. Raises SequenceError where a
    complete file is damaged, or of another recipe.
    """
    home, made_by = split_folder(split, salt), digest(split, salt)
    taken: Taken = {}
    told: dict[str, list[str]] = {}
    for sequence in missing:
        wanted = wanted_topics(split, sequence, topics)
        smaller: dict[Path, set[str]] = {}
        source: Path | None = sequence_files(split, home)[sequence.name]
        if source is not None and source.is_file():
            check_made_by(source, split, made_by)
        else:
            smaller = _whole_files(smaller_files(home, sequence.name), made_by, set(wanted), tell)
            source = next((path for path, has in smaller.items() if has >= wanted.keys()), None)
        if source is not None:
            cut_to(folder / source.name, source, wanted)
            told.setdefault(f"all topics are cut from {source.parent}", []).append(sequence.name)
        elif found := _frames(split, sequence, topics, smaller):
            taken[sequence.name] = found
            places = listed(str(path.parent) for path in dict.fromkeys(found.values()))
            told.setdefault(f"{listed(found)} are taken from {places}", []).append(sequence.name)
    for what, names in told.items():
        tell(f"{folder}: {listed(names)}: {what}, and not rendered again")
    return taken


def _whole_files(
    paths: Iterable[Path], made_by: str, wanted: set[str], tell: Callable[[str], None]
) -> dict[Path, set[str]]:
    """Undamaged files, of the recipe with this digest and the sequence of their name -> which of the wanted topics they
    have, those with most first, and none after one that has all: each is read through."""
    found = {}
    for path in paths:
        try:
            here = McapSequence(path)
        except SequenceError as error:
            tell(f"not used: {error}")
            continue
        # The digest is that of the split, so a file under another sequence's name has it too.
        ours = here.metadata.get("digest") == made_by and here.name == path.stem
        if ours and (has := wanted & set(here.types)):
            found[path] = has
    whole: dict[Path, set[str]] = {}
    for path, has in sorted(found.items(), key=lambda item: -len(item[1])):
        if not is_whole(path):
            tell(f"not used: {path}: damaged; delete it and render or download it again")
            continue
        whole[path] = has
        if has == wanted:
            break
    return whole


def _frames(
    split: SplitRecipe, sequence: SequenceRecipe, topics: Collection[str], smaller: Mapping[Path, set[str]]
) -> dict[str, Path]:
    """Topic -> file, of the cameras and sonars of which files have all topics asked for. The other sensors are
    simulated together, in seconds."""
    source_of = sources(split.rig_of(sequence))
    found: dict[str, Path] = {}
    for topic in wanted_topics(split, sequence, topics):
        path = next((path for path, has in smaller.items() if topic in has), None)
        if path is not None and source_of.get(topic):
            found[topic] = path
    rendered = wanted_sensors(split, sequence, topics, found)
    return {topic: path for topic, path in found.items() if source_of[topic] not in rendered}
