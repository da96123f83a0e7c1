"""The card of trained weights: their file, how and from what they were made, what they achieve, what they are for.
Immutable once released, like a manifest."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

import msgspec

from oysterbench.hub.canonical import Sha256, canonical, decode, sha256
from oysterbench.hub.manifest import NAME, VERSION_NAME
from oysterbench.hub.pieces import PIECE, Pieced, PieceSize

ModelName = Annotated[str, msgspec.Meta(pattern=rf"^{NAME.pattern}\Z")]
ModelVersion = Annotated[str, msgspec.Meta(pattern=rf"^{VERSION_NAME.pattern}\Z")]
WeightsName = Annotated[str, msgspec.Meta(pattern=rf"^{NAME.pattern}\.pt\Z")]
"""Names that cannot lead out of a folder."""


class WeightsFile(Pieced, msgspec.Struct, frozen=True):
    """A weights file: its name in the folder of models, size in bytes, SHA-256 of the whole and of each piece."""

    name: WeightsName
    size: Annotated[int, msgspec.Meta(ge=1)]
    sha256: Sha256
    pieces: tuple[Sha256, ...]
    piece_size: PieceSize = PIECE


class Origin(msgspec.Struct, frozen=True):
    """Weights from which a training started. source: an address, or the command that made them"""

    what: str
    licence: str
    source: str


class Training(msgspec.Struct, frozen=True):
    """How weights were trained.

    data:       training data, name -> digest
    steps:      of the optimiser; loss: mean over the last of them; cpu_s: processor time in s
    settings:   everything else that decides the weights; device: cpu or cuda
    parameters: number of the network's trained parameters
    versions:   of the software used
    begun:      weights from which training started; None for random ones
    """

    data: dict[str, str]
    steps: int
    seed: int
    settings: dict[str, Any]
    device: str
    parameters: int
    loss: float
    cpu_s: float
    versions: dict[str, str]
    begun: Origin | None = None


class Figure(msgspec.Struct, frozen=True):
    """A metric that a method achieved with these weights: its mean over the sequences of a split or, for an error of a
    track that has them, its median over those that are not lost.

    heading, unit, better: of the metric; low, high: 95 % confidence interval of the mean, None where there is none
    evaluator: version that scored it; results: SHA-256 of the file with the results
    """

    method: str
    track: str
    split: str
    split_digest: str
    sequences: int
    metric: str
    heading: str
    unit: str
    better: str
    value: float
    evaluator: str
    results: Sha256
    low: float | None = None
    high: float | None = None


class Model(msgspec.Struct, frozen=True, dict=True, kw_only=True):
    """A version of trained weights.

    methods: those that use them; summary: what they are, in one line; limits: what they are not for, in sentences
    licence: of the weights, an address
    """

    name: ModelName
    version: ModelVersion
    methods: tuple[str, ...]
    summary: str
    limits: str
    licence: str
    file: WeightsFile
    training: Training
    figures: tuple[Figure, ...] = ()
    oysterbench: str
    format: Literal["oysterbench-model/1"] = "oysterbench-model/1"

    @cached_property
    def data(self) -> bytes:
        """The card as canonical JSON."""
        return canonical(msgspec.to_builtins(self))

    @cached_property
    def sha256(self) -> str:
        """The card's own hash, which is its name."""
        return sha256(self.data)


def read_model(data: bytes, what: str) -> Model:
    """Read a card from its bytes. Raises IntegrityError naming `what` and the first key that is wrong."""
    model = decode(data, Model, what)
    model.file.check(what)
    return model
