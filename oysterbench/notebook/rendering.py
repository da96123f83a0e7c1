"""Rendering of the missing sequence files of a split, and what is shown meanwhile."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.core.errors import MachineError, SequenceError
from oysterbench.notebook.progress import frames_bar, in_words, say

if TYPE_CHECKING:
    from oysterbench.recipe import SequenceRecipe, SplitRecipe

TOLD_FROM_S = 60.0
"""Expected rendering time, s, from which it is announced beforehand."""


def render_files(
    split: SplitRecipe,
    folder: Path | None = None,
    workers: int | None = None,
    names: tuple[str, ...] = (),
    salt: bytes = b"",
    device: str = "cpu",
    scheduler: str | None = None,
    quiet: bool = False,
    topics: tuple[str, ...] = (),
) -> dict[str, Path]:
    """Return the sequence files of a split, by name, after rendering the missing ones with a progress bar.

    quiet: show nothing. topics: patterns; makes smaller files with no other topics, in a folder of their own. Frames
    that files under the home folder have already are not rendered again (`simulation.reuse`). Raises MachineError,
    which says what to type, where the renderer is not installed, and SequenceError where smaller files would be put
    among complete ones.
    """
    from oysterbench.simulation import cost
    from oysterbench.simulation.generate import check_workers, default_workers, generate_split, share_left, split_folder
    from oysterbench.simulation.reuse import reuse

    folder = _folder(split, folder, salt, topics)
    tell = (lambda line: None) if quiet else say
    # Complete files elsewhere are rendered as a whole: it is how a release is reproduced.
    reusing = topics or folder.resolve() == split_folder(split, salt).resolve()
    taken = reuse(split, folder, _missing(split, folder, names), topics, salt, tell) if reusing else {}
    missing = _missing(split, folder, names)
    if missing and scheduler is None:
        check_renderer(f"{split.name}: {missing[0].name} is not here, and")

    def cpu_s(workers: int) -> float:
        return sum(
            share_left(split, one, folder, salt, topics, taken.get(one.name, ()))
            * cost.estimated(split, one, workers, topics, taken.get(one.name, ()))
            for one in missing
        )

    workers = default_workers(cpu_s(1)) if workers is None else check_workers(workers)
    if scheduler is None and device == "cpu" and not quiet:
        _announce(split, missing, workers, cpu_s(workers) / workers)
    with nullcontext() if quiet else frames_bar(f"rendering {split.name}") as progress:
        waiting = None if quiet else partial(_wait, folder)
        return generate_split(
            split, folder, workers, progress, salt, device, scheduler, names, waiting, topics, tell, taken
        )


def _wait(folder: Path) -> None:
    """Tell the user about the wait: only one process at a time renders into a folder, with its own workers."""
    say(f"{folder}: waiting for another process that renders into this folder")


def check_renderer(wanted: str) -> None:
    """Raise MachineError, which says what to type, where the renderer is not installed. wanted: start of the message"""
    if find_spec("warp") is None:
        raise MachineError(
            f"{wanted} rendering is not installed: pip install 'oysterbench[render]'; or set a hub that has it "
            "(OYSTERBENCH_HUB)"
        )


def _missing(split: SplitRecipe, folder: Path, names: tuple[str, ...]) -> list[SequenceRecipe]:
    """Sequences that are requested and do not exist yet."""
    from oysterbench.simulation.generate import sequence_files

    files = sequence_files(split, folder)
    wanted = [sequence for sequence in split.sequence if not names or sequence.name in names]
    return [sequence for sequence in wanted if not files[sequence.name].exists()]


def _folder(split: SplitRecipe, folder: Path | None, salt: bytes, topics: tuple[str, ...]) -> Path:
    """Folder for the files: as given, or under the home folder; never that of complete files for smaller ones."""
    from oysterbench.sequence.cut import topics_folder
    from oysterbench.simulation.generate import split_folder

    whole = split_folder(split, salt)
    folder = folder or (topics_folder(whole, topics) if topics else whole)
    if topics and folder.resolve() == whole.resolve():
        raise SequenceError(
            f"{folder}: complete sequences are kept here, which smaller ones would be taken for: choose another folder "
            "with --out, or leave it out"
        )
    return folder


def _announce(split: SplitRecipe, missing: list[SequenceRecipe], workers: int, seconds: float) -> None:
    """Announce how long rendering will take, if it is more than TOLD_FROM_S."""
    if seconds > TOLD_FROM_S:
        what = missing[0].name if len(missing) == 1 else f"{len(missing)} sequences"
        on = f"{workers} worker{'s' if workers > 1 else ''}"
        say(f"rendering {split.name}: {what} will take about {in_words(seconds)} on {on}")
