"""Where data is stored, and whether the name of a file leads elsewhere."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

MODELS = "OYSTERBENCH_MODELS"
"""Environment variable that names the folder of locally trained weights."""


def home() -> Path:
    """Folder of rendered and downloaded data: `OYSTERBENCH_HOME`, or the user's data folder."""
    chosen = os.environ.get("OYSTERBENCH_HOME")
    if chosen:
        return Path(chosen).expanduser()
    import platformdirs

    return Path(platformdirs.user_data_dir("oysterbench"))


def home_problem() -> str:
    """Why the home folder cannot be made or used as a folder; empty where it can."""
    folder = home()
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    if there.is_dir():
        return ""
    return f"{there} is a {'file' if there.exists() else 'link to something that is not there'}"


def models() -> Path:
    """Folder of locally trained weights: `OYSTERBENCH_MODELS`, or `models` in the home folder."""
    return Path(os.environ.get(MODELS) or home() / "models").absolute()


def released_models() -> Path:
    """Folder of the trained weights that are part of oysterbench."""
    return Path(str(resources.files("oysterbench_datasets"))) / "models"


def leads_out(name: str) -> bool:
    """Whether a path, relative to a folder, leads out of that folder: names of files in it must not.

    >>> leads_out("clip/1.png"), leads_out("clip/../../1.png"), leads_out("/tmp/1.png")
    (False, True, True)
    """
    return os.path.isabs(name) or os.path.normpath(name).split(os.sep)[0] == os.pardir


SYSTEM = (
    "thumbs.db",
    "desktop.ini",
    "$recycle.bin",
    "system volume information",
    "__macosx",
    "@eadir",
    "#recycle",
    "#snapshot",
    "lost+found",
)
"""What Windows, macOS, network storage and file systems keep beside a user's files, in lower case."""


def is_hidden(path: Path, folder: Path) -> bool:
    """Whether a file of a folder, or another folder on the way to it, is one that systems and editors keep for
    themselves: its name begins with a dot, or is one of `SYSTEM`.

    >>> is_hidden(Path("set/.ipynb_checkpoints/a.png"), Path("set")), is_hidden(Path(".set/a.png"), Path(".set"))
    (True, False)
    """
    parts = path.relative_to(folder).parts
    return any(part.startswith(".") or part.casefold() in SYSTEM for part in parts)


def shown(folder: Path, pattern: str) -> list[Path]:
    """What a folder itself holds that matches a pattern and is not hidden, in order; nothing if it is no folder."""
    return sorted(path for path in folder.glob(pattern) if not is_hidden(path, folder))
