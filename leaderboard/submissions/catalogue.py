"""The splits that a server accepts submissions to: their sequences and images, and where their ground truth is.

`Wanted` is what anybody may know of a split; `Served` adds where the ground truth is, and stays on the server.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.hub.canonical import canonical, sha256
from oysterbench.recipe.steering import SteeringRecipe
from oysterbench_leaderboard.submissions.reading.refusals import Refusal

if TYPE_CHECKING:
    from oysterbench.recipe import SplitRecipe

TRACKS_OF = {"slam": ("slam",), "segmentation": ("segmentation", "detection"), "steering": ("steering",)}
"""Track of a split's recipe -> tracks that are scored on it."""

SCORED = tuple(track for tracks in TRACKS_OF.values() for track in tracks)
"""Tracks that can be submitted."""

ELSEWHERE = {
    "density": "maps are scored locally: `oysterbench eval --track density`",
    "exploration": "rollouts are scored locally: `oysterbench eval --track steering --closed-loop`",
}
"""Track that cannot be submitted -> why."""

Kind = Literal["poses", "predictions", "commands", "results"]
"""What is sent: paths, masks or instances of images, commands at images, or results that were computed elsewhere."""

KIND_OF: dict[str, Kind] = {
    "slam": "poses",
    "segmentation": "predictions",
    "detection": "predictions",
    "steering": "commands",
}
"""Track -> kind of predictions that it takes."""

Images = Mapping[str, Mapping[str, tuple[int, int]]]
"""Sequence -> name of an image -> height and width, px."""


@dataclass(frozen=True)
class Wanted:
    """What predictions on a split and track must cover.

    split_digest, conditions: as in results; hidden: whether only the server has the ground truth
    images: those that need predictions or commands; empty where they are not known, as on a client that has not
            downloaded them
    task:   for the track steering, the table [steering] of the recipe
    spans:  sequence -> start and end of its recording, ns, which are not secret: every message's stamp tells them
    counts: sequence -> number of its images, which a client that does not know them learns from the server
    """

    track: str
    split: str
    split_digest: str
    hidden: bool
    sequences: tuple[str, ...]
    conditions: Mapping[str, Mapping[str, float | str]] = field(default_factory=dict)
    images: Images = field(default_factory=dict)
    task: SteeringRecipe | None = None
    spans: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def kind(self) -> Kind:
        """Kind of the predictions."""
        return KIND_OF[self.track]

    @property
    def of_images(self) -> bool:
        """Whether masks or instances of images are sent."""
        return self.kind == "predictions"

    def size(self, image: str) -> tuple[int, int] | None:
        """Height and width of an image by its name, px; None where it is not known."""
        return self.images.get(image.partition("/")[0], {}).get(image)


@dataclass(frozen=True)
class Served:
    """A split that is served. wanted: by track; truth: sequence -> its file; empty for a public split that was not
    rendered here, for which only results computed elsewhere are accepted."""

    wanted: Mapping[str, Wanted]
    truth: Mapping[str, Path]

    @property
    def any(self) -> Wanted:
        """`Wanted` of one of its tracks: all share split, digest and sequences."""
        return next(iter(self.wanted.values()))


class Catalogue:
    """All splits that are served, by name."""

    def __init__(self, served: Iterable[Served]) -> None:
        self.splits = {one.any.split: one for one in served}

    def find(self, split: str, track: str) -> tuple[Served, Wanted]:
        """Return a split, and its track (the first if empty). Raises Refusal that lists those there are."""
        if split not in self.splits:
            known = ", ".join(self.splits) or "none"
            if not split:
                raise Refusal("split", f"expected the split that was predicted, one of {known}, got none")
            raise Refusal("split", f"submissions to {split!r:.60} are not accepted here; the splits are {known}")
        served = self.splits[split]
        if track and track not in served.wanted:
            raise Refusal("split", f"{split} has the tracks {', '.join(served.wanted)}, got {track!r:.60}{why(track)}")
        return served, served.wanted[track] if track else served.any

    def public(self) -> list[dict[str, Any]]:
        """Description of the splits for clients: what each accepts."""
        return [
            {
                "split": name,
                "tracks": list(one.wanted),
                "hidden": one.any.hidden,
                "takes": ["estimates"] * bool(one.truth) + ["results"] * (not one.any.hidden),
                "sequences": list(one.any.sequences),
                "images": {sequence: len(named) for sequence, named in one.any.images.items()},
                "task": msgspec.to_builtins(one.any.task),
                "spans": one.any.spans,
            }
            for name, one in self.splits.items()
        ]


def why(track: str) -> str:
    """Reason why a track cannot be submitted, to be appended to a refusal; empty where it can."""
    if track in SCORED:
        return ""
    reason = f": {ELSEWHERE[track]}" if track in ELSEWHERE else ""
    return f"{reason}; the tracks that can be submitted are {', '.join(SCORED)}"


def serve_split(name_or_path: str, truth: Path | None = None, cache: Path | None = None) -> Served:
    """Load a split by its name or recipe, with its ground truth.

    truth: folder of its sequence files; None for where public splits are rendered
    cache: folder for the names of images, which are slow to read

    Raises ResultError where a file of the ground truth is missing or belongs to another split.
    """
    from oysterbench.recipe import load_split
    from oysterbench.simulation.conditions import conditions
    from oysterbench.simulation.generate import digest, is_complete, sequence_files, split_folder

    split = load_split(name_or_path)
    if split.track not in TRACKS_OF:
        raise ResultError(f"split {split.name}: the track {split.track} is not scored by this version of oysterbench")
    files: dict[str, Path] = {}
    if truth is not None:
        files = sequence_files(split, truth.absolute())
        if missing := [str(path) for path in files.values() if not path.is_file()]:
            raise ResultError(f"--truth {split.name}: expected {missing[0]}; render the split there, with its salt")
    elif split.hidden:
        raise ResultError(f"split {split.name} is hidden: expected --truth {split.name}=FOLDER with its sequences")
    elif is_complete(split, split_folder(split)):
        files = sequence_files(split, split_folder(split))
    for name, path in files.items():
        _check(split, name, path)
    found = {sequence.name: conditions(split, sequence.name) for sequence in split.sequence}
    names = tuple(sequence.name for sequence in split.sequence)
    images = {name: _images_of(path, split.track, cache) for name, path in files.items() if split.track in NAMED}
    wanted = {
        track: Wanted(
            track, split.name, digest(split), split.hidden, names, found, images, split.steering, spans_of(split)
        )
        for track in TRACKS_OF[split.track]
    }
    return Served(wanted, files)


def spans_of(split: SplitRecipe) -> dict[str, tuple[int, int]]:
    """Sequence -> start and end of its recording, ns."""
    from oysterbench.core.ros import EPOCH_NS  # here, so that a reader of uploads need not load all ROS messages

    return {one.name: (EPOCH_NS, EPOCH_NS + round(1e9 * one.duration_s)) for one in split.sequence}


def _check(split: Any, name: str, path: Path) -> None:
    """Refuse ground truth of another split or, for a public split, of another recipe, and files without ground truth.
    Raises ResultError."""
    from oysterbench.sequence.cut import is_scorable
    from oysterbench.sequence.read import McapSequence
    from oysterbench.simulation.generate import digest

    sequence = McapSequence(path)
    metadata = sequence.metadata
    wanted = {"sequence": name, "split": split.name, "split_version": split.version}
    if not split.hidden:
        wanted["digest"] = digest(split)
    for key, value in wanted.items():
        if metadata.get(key) != value:
            raise ResultError(
                f"{path}: expected {key} {value!r}, got {metadata.get(key)!r}: the truth of another split"
            )
    if not is_scorable(sequence):
        raise ResultError(
            f"{path}: expected ground truth, got a file as teams get it; "
            "--truth names the folder of the files as they were rendered"
        )


def _masked(path: Path) -> tuple[str, ...]:
    from oysterbench.annotations import labelled_sequence

    return tuple(labelled_sequence(path).names)


def _steered(path: Path) -> tuple[str, ...]:
    from oysterbench.sequence import open_sequence

    sequence = open_sequence(path)
    camera = next(iter(sequence.cameras))
    return tuple(f"{sequence.name}/{camera}/{stamp}" for stamp in sequence.steering()["stamp_ns"].tolist())


NAMED: dict[str, Callable[[Path], tuple[str, ...]]] = {"segmentation": _masked, "steering": _steered}
"""Track of a recipe -> function that lists the images of a sequence that have ground truth."""


def _images_of(path: Path, track: str, cache: Path | None) -> dict[str, tuple[int, int]]:
    """Names of the images of a sequence that have ground truth, with their heights and widths, px."""
    from oysterbench.sequence import open_sequence

    state = path.stat()
    key = sha256(canonical([str(path.resolve()), state.st_size, state.st_mtime_ns]))
    kept = None if cache is None else cache / f"{key}.json"
    if kept is not None and kept.is_file():
        return {name: (int(h), int(w)) for name, (h, w) in json.loads(kept.read_bytes()).items()}
    cameras = open_sequence(path).cameras
    found = {}
    for name in NAMED[track](path):
        camera = cameras[name.split("/")[1]]
        found[name] = (camera.height, camera.width)
    if kept is not None:
        write_atomically(kept, canonical(found))
    return found


def local_wanted(split_name: str, track: str) -> Wanted:
    """What a client knows of a split: its recipe and, if it was downloaded or rendered, its images."""
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import digest, is_complete, split_folder

    split = load_split(split_name)
    if not split.hidden and is_complete(split, split_folder(split)):
        try:
            return serve_split(split_name).wanted[track]
        except (OysterbenchError, KeyError):
            pass
    names = tuple(sequence.name for sequence in split.sequence)
    return Wanted(track, split.name, digest(split), split.hidden, names, task=split.steering, spans=spans_of(split))


def served_splits(truths: Iterable[str], cache: Path | None = None) -> Catalogue:
    """All splits to serve: those of `truths` (SPLIT=FOLDER or FILE.toml=FOLDER), and every other public split of a
    track that is scored. Raises ResultError."""
    from oysterbench.recipe import load_split, split_names

    found: dict[str, Served] = {}
    for given in truths:
        split, _, place = given.partition("=")
        if not split or not place:
            raise ResultError(f"--truth: expected SPLIT=FOLDER or FILE.toml=FOLDER, got {given!r}")
        served = serve_split(split, Path(place), cache)
        found[served.any.split] = served
    for name in split_names():
        recipe = load_split(name)
        if name not in found and not recipe.hidden and recipe.track in TRACKS_OF:
            found[name] = serve_split(name, None, cache)
    return Catalogue(found.values())
