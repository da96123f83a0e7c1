"""Publishing trained weights: with their card and its page into a static tree, or as part of oysterbench."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec.structs import replace

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import HubError, IntegrityError
from oysterbench.hub.canonical import sha256
from oysterbench.hub.card import card_page
from oysterbench.hub.index import ModelRelease
from oysterbench.hub.model import Figure, Model, Training, WeightsFile, read_model
from oysterbench.hub.pieces import PIECE, hashed
from oysterbench.hub.publish import Announce, put, put_again, put_blob, put_index, writing
from oysterbench.hub.relisted import listed_card
from oysterbench.hub.verify import kept_card
from oysterbench.version import VERSION


def describe_weights(name: str, path: Path, piece_size: int = PIECE) -> WeightsFile:
    """Hash a weights file: the whole and its pieces. name: of the model"""
    size, whole, pieces = hashed(path, piece_size)
    return WeightsFile(name=f"{name}.pt", size=size, sha256=whole, pieces=pieces, piece_size=piece_size)


def build_model(
    name: str,
    version: str,
    methods: Sequence[str],
    words: tuple[str, str, str],
    file: WeightsFile,
    training: Training,
    figures: Sequence[Figure] = (),
) -> Model:
    """Build the card of weights. words: summary, limits and licence"""
    summary, limits, licence = words
    return Model(
        name=name,
        version=version,
        methods=tuple(methods),
        summary=summary,
        limits=limits,
        licence=licence,
        file=file,
        training=training,
        figures=tuple(figures),
        oysterbench=VERSION,
    )


def publish_model(
    tree: Path,
    model: Model,
    weights: Path,
    key: Ed25519PrivateKey,
    announce: Announce = lambda text: None,
    old_keys: Sequence[Ed25519PrivateKey] = (),
) -> Model:
    """Publish a model with its weights. As for a split, files go first and the signed index last, and publishing twice
    adds nothing.

    Raises HubError where the version was released with another card or other weights, a split has the name, or the file
    changed meanwhile.
    """
    keys = (key, *old_keys)
    with writing(tree, *keys) as index:
        if model.name in index.splits:
            raise HubError(f"{model.name}: a split in {tree} has this name, and `download` finds both by name")
        known = index.models.get(model.name, {}).get(model.version)
        if known is not None:
            model = listed_card(tree, known, model)
        if known is not None and known.card != model.sha256:
            card = tree / "models" / f"{known.card}.json"
            if not card.is_file() or sha256(card.read_bytes()) != known.card:
                raise HubError(
                    f"{card}: damaged or missing, and not what would be published now; the tree was left unchanged: "
                    "copy it from a mirror of the tree, or publish the same weights with the same words and results"
                )
            raise HubError(
                f"{model.name} {model.version} was released with other weights or another card ({known.card[:12]}…, "
                f"now {model.sha256[:12]}…) and a release never changes; the tree was left unchanged: give another "
                "--version"
            )
        new = put_blob(tree, weights, model.file.sha256)
        announce(f"{model.file.name}, {model.file.size / 1e6:.1f} MB: {'published' if new else 'already there'}")
        put(tree / "models" / f"{model.sha256}.json", model.data)
        page = card_page(model).encode()
        if known is not None:
            put_again(tree / "cards" / f"{known.page}.html", lambda: [page], announce)
        else:
            put(tree / "cards" / f"{sha256(page)}.html", page)
            release = ModelRelease(
                model=model.name,
                version=model.version,
                card=model.sha256,
                card_size=len(model.data),
                size=model.file.size,
                methods=model.methods,
                summary=model.summary,
                published=datetime.now(UTC).date().isoformat(),
                page=sha256(page),
            )
            index = index.with_model(release)
        put_index(tree, index, keys)
    return model


def _as_before(card: Path, model: Model) -> Model:
    """The model with the version of oysterbench that its card, if released before, names: a later one alone makes no
    other release."""
    with suppress(FileNotFoundError, IntegrityError):
        earlier = read_model(card.read_bytes(), str(card))
        if (as_before := replace(model, oysterbench=earlier.oysterbench)) == earlier:
            return as_before
    return model


def write_released(model: Model, weights: Path, folder: Path) -> Path:
    """Write trained weights and their card among those that are part of oysterbench, in place of an earlier version.

    Raises HubError where this version was released with another card or other weights, or the file changed meanwhile.
    """
    path = folder / f"{model.name}.pt"
    model = _as_before(path.with_suffix(".json"), model)
    known = kept_card(path)
    if known is not None and known.version == model.version and known.sha256 != model.sha256:
        raise HubError(
            f"{path}: {model.name} {model.version} was released with other weights or another card, and a release "
            "never changes; it was left unchanged: give another --version, or delete it if it has not been distributed"
        )
    data = weights.read_bytes()
    if sha256(data) != model.file.sha256:
        raise HubError(f"{weights}: changed while it was read; the release was left unchanged")
    write_atomically(path, data)
    write_atomically(path.with_suffix(".json"), model.data)
    return path
