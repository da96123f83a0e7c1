"""Trained weights on this machine: what is known about them, and fetching them from a hub.

```
<models>/NAME.pt      weights, whether they were trained here or fetched
<models>/NAME.json    the card of those that were fetched (`model`)
```

Those that are part of oysterbench lie in the same way in `datasets/models`, and are used where there are no others.

A card is trusted only for a file whose hash it names.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import HubError
from oysterbench.core.locks import locked_if_possible
from oysterbench.core.places import released_models
from oysterbench.hub.download import Hub, Progress, check_space, fetch_file, part_path
from oysterbench.hub.model import Model
from oysterbench.hub.pieces import Pieced
from oysterbench.hub.verify import kept_card


@dataclass(frozen=True)
class Here:
    """A weights file on this machine. card: the one next to it; model: the same, if it is for this very file"""

    path: Path
    sha256: str
    card: Model | None
    model: Model | None

    @property
    def released(self) -> bool:
        """Whether it is part of oysterbench."""
        return self.path.parent == released_models()

    @property
    def brief(self) -> str:
        """Version from a hub, or else where the file is from."""
        if self.model is not None:
            return f"{self.model.version}, part of oysterbench" if self.released else self.model.version
        return "trained here" if self.card is None else f"not {self.card.version}"

    @property
    def described(self) -> str:
        """Description of the file in words."""
        state, what = self.path.stat(), "weights trained here"
        if self.model is not None:
            what = f"{self.model.name} {self.model.version}{' of a hub' if not self.released else ''}"
        elif self.card is not None:
            what = f"weights that are not {self.card.name} {self.card.version}, whose card is beside them"
        day = datetime.fromtimestamp(state.st_mtime).date().isoformat()
        return f"{what} ({state.st_size / 1e6:.1f} MB of {day}, SHA-256 {self.sha256[:12]}…)"


def weights_here(path: Path) -> Here | None:
    """What is known about a weights file; None where there is none."""
    if not path.is_file():
        return None
    with open(path, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    card = kept_card(path)
    return Here(path, digest, card, card if card is not None and card.file.sha256 == digest else None)


def there_bytes(path: Path, entry: Pieced) -> int:
    """Approximate number of a file's bytes that an interrupted download left."""
    part = part_path(path.parent, entry)
    return min(part.stat().st_blocks * 512, entry.size) if part.is_file() else 0


def check_replaced(path: Path, model: Model, again: bool = False) -> bool:
    """Whether this model is already at a path. Raises HubError where there are weights that did not come from a hub, or
    a file that is no card has its card's name, which a download may replace only with `again`."""
    here, card = weights_here(path), path.with_suffix(".json")
    if here is None:
        if card.is_file() and kept_card(path) is None and not again:
            raise HubError(
                f"{card}: a different file has this name; it was left unchanged: --again replaces it with the card of "
                f"{model.name} {model.version}, --out downloads it into another folder"
            )
        return False
    if here.sha256 == model.file.sha256:
        return True
    if here.model is None and not again:
        raise HubError(
            f"{path}: there are {here.described}; they were left unchanged: --again replaces them with {model.name} "
            f"{model.version}, --out downloads it into another folder"
        )
    return False


def fetch_weights(
    hub: Hub, model: Model, path: Path, again: bool = False, progress: Progress = lambda done, total: None
) -> Path:
    """Fetch a model's weights to a path, with their card next to them.

    Weights of another version from a hub are replaced once the new ones are complete; one's own only with `again`, and
    otherwise HubError is raised. Raises IntegrityError or NetworkError where it fails; what was fetched is kept, and
    the same call resumes from there.
    """
    entry, part, done = model.file, part_path(path.parent, model.file), 0

    def count(n: int) -> None:
        nonlocal done
        done += n
        progress(done, entry.size)

    with locked_if_possible(part.with_suffix(".lock")):
        if check_replaced(path, model, again):
            count(entry.size)
        else:
            check_space(path.parent, entry.size - there_bytes(path, entry))
            count(0)
            fetch_file(hub, entry, part, path, count)
        write_atomically(path.with_suffix(".json"), model.data)
    return path
