"""One cell: train, predict, score, and keep the results in a folder of its own."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations import LabelledSet
from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MethodError, ResultError
from oysterbench.core.locks import locked
from oysterbench.core.streams import Streams
from oysterbench.results.records import ResultRecord, read_results, write_results
from oysterbench_baselines.learning.batches import Mixture, initial_seed, make_batch
from oysterbench_baselines.learning.checkpoint import Checkpoint
from oysterbench_baselines.learning.loop import Progress, fit, pick_device
from oysterbench_baselines.learning.losses import mask_loss
from oysterbench_baselines.learning.masks import MaskModel, enlarged, probability
from oysterbench_baselines.learning.samples import LabelledDataset
from oysterbench_baselines.sim2real.data import Real, drawn
from oysterbench_baselines.sim2real.scoring import EVALUATORS, WHOLE, Prediction, Score, Truth, score
from oysterbench_baselines.sim2real.settings import Cell, ExperimentSettings
from oysterbench_baselines.unet.instances import find_instances
from oysterbench_baselines.unet.model import described, unet_model
from oysterbench_baselines.unet.network import UNetworkSettings
from oysterbench_baselines.unet.training import new_network

RESULT, PREDICTIONS, CHECKPOINT, LOCK = "results.json", "predictions.npz", "checkpoint.pt", ".lock"
STEP = 0.1
"""Resolution at which the logits of predictions are stored: at most 0.025 in probability."""


Source = LabelledSet | Checkpoint
"""Source of the training that precedes real images: synthetic images, or weights trained on such."""


@dataclasses.dataclass
class Bench:
    """Data and settings that all cells share; images that several cells use are read once.

    synthetic: by the names that cells use. Raises MethodError for weights of another network than that of the settings
    shared: folder of the trainings on synthetic images alone, which do not depend on the real ones, where several
    benches share them; None: among the cells
    """

    real: Real
    synthetic: Mapping[str, Source]
    settings: ExperimentSettings
    device: str = "auto"
    shared: Path | None = None

    def __post_init__(self) -> None:
        scale, side = self.settings.network.scale, self.settings.network.side
        self._weights = {name: one for name, one in self.synthetic.items() if isinstance(one, Checkpoint)}
        for name, checkpoint in self._weights.items():
            _check_network(name, checkpoint, self.settings.network)
        sets = {name: one for name, one in self.synthetic.items() if isinstance(one, LabelledSet)}
        self._datasets = {name: LabelledDataset(labelled, scale, side) for name, labelled in sets.items()}
        self._train = LabelledDataset(self.real.train, scale, side)
        self._place = {entry.name: k for k, entry in enumerate(self.real.train.entries)}
        self._digests = {name: one.digest() for name, one in self.synthetic.items()}
        self.test_digest = self.real.test.digest()
        self._drawn: dict[tuple[int, int], str] = {}
        self._truth: Truth | None = None

    @property
    def truth(self) -> Truth:
        """Ground truth of the test images, read on first use."""
        if self._truth is None:
            self._truth = Truth.of(self.real.test)
        return self._truth

    def steps(self, cell: Cell) -> int:
        """Number of steps of a cell's own training, without the one it starts from; 0 where its weights are given."""
        return 0 if self._given(cell) else self.settings.fit_of(cell).steps

    def _given(self, cell: Cell) -> bool:
        return cell.size is None and cell.synthetic in self._weights

    def identity(self, cell: Cell) -> dict[str, Any]:
        """Identity of a cell: all that determines its weights, and its test data, as plain values."""
        settings = self.settings
        parts: dict[str, Any] = {
            "network": settings.network,
            "augmentation": settings.augmentation,
            "fit": None if self._given(cell) else settings.fit_of(cell),
            "begun": None if cell.begun is None or self._given(cell.begun) else settings.fit_of(cell.begun),
        }
        plain = {key: dataclasses.asdict(value) if value else None for key, value in parts.items()}
        batch = {"crops": settings.batch, "synthetic": self._kept(cell)}
        data = {
            "synthetic": self._digests.get(cell.synthetic, ""),
            "real": self._real_digest(cell.size, cell.seed),
            "test": self.test_digest,
        }
        found = {
            "method": "unet",
            "cell": [cell.synthetic, cell.size, cell.seed],
            "settings": {**plain, "batch": batch},
            "data": data,
            "device": pick_device(self.device).type,
        }
        return dict(json.loads(json.dumps(found)))

    def _real_digest(self, size: int | None, seed: int) -> str:
        """Digest of the real images of a cell; empty where it has none."""
        if size is None:
            return ""
        if (size, seed) not in self._drawn:
            self._drawn[size, seed] = drawn(self.real.train, size, seed).digest()
        return self._drawn[size, seed]

    def train(self, cell: Cell, folder: Path, progress: Progress) -> MaskModel:
        """Train the network of a cell, or resume from its checkpoint, and return the model."""
        return unet_model(self._trained(cell, folder, progress), pick_device(self.device))

    def _trained(self, cell: Cell, folder: Path, progress: Progress) -> Checkpoint:
        settings = self.settings
        streams = Streams(cell.seed).at("sim2real")
        if self._given(cell):
            return self._weights[cell.synthetic]
        if cell.size is None and self.shared is not None and folder.parent != self.shared:
            return self._waited(cell, self.shared, progress)
        begun = None if cell.begun is None else self._weights.get(cell.synthetic)
        if cell.begun is not None and begun is None:
            begun = self._waited(cell.begun, self.shared or folder.parent, lambda done, total: None)
        images = self._images(cell)
        return fit(
            lambda: new_network(settings.network, begun),
            described(settings.network),
            lambda step: make_batch(images, settings.augmentation, streams, step),
            mask_loss,
            settings.fit_of(cell),
            self._trained_on(cell),
            folder / CHECKPOINT,
            pick_device(self.device),
            initial_seed(streams),
            progress,
        )

    def _waited(self, cell: Cell, cells: Path, progress: Progress) -> Checkpoint:
        folder = cells / cell.folder
        with locked(folder / LOCK):  # another process may be training it
            return self._trained(cell, folder, progress)

    def _trained_on(self, cell: Cell) -> dict[str, Any]:
        """Identity of a cell without its test data."""
        identity = self.identity(cell)
        return {**identity, "data": {key: value for key, value in identity["data"].items() if key != "test"}}

    def _images(self, cell: Cell) -> Mixture:
        """Images of a cell's own training, without those of the one it starts from (`Cell.begun`)."""
        batch, kept = self.settings.batch, self._kept(cell)
        synthetic = [self._datasets[cell.synthetic]] if kept else []
        if cell.size is None:
            return Mixture(synthetic, [kept])
        chosen = drawn(self.real.train, cell.size, cell.seed)
        real = Subset(self._train, [self._place[entry.name] for entry in chosen.entries], chosen)
        return Mixture([*synthetic, real], [kept, batch - kept] if kept else [batch])

    def _kept(self, cell: Cell) -> int:
        """Number of synthetic crops in each batch of a cell."""
        if cell.size is None:
            return self.settings.batch
        return self.settings.schedule.kept if cell.synthetic in self._datasets else 0

    def predictions(self, model: MaskModel) -> Iterator[NDArray[np.int8]]:
        """Logits (K, h, w) of each test image at the working scale, in units of `STEP`, rounded to int8."""
        for pixels in self.truth.pixels:
            yield np.clip(np.round(model.small_logits(pixels) / STEP), -127, 127).astype(np.int8)


def _check_network(name: str, weights: Checkpoint, settings: UNetworkSettings) -> None:
    """Raise MethodError for weights of another network; its images may have been of another size."""
    expected = described(settings)
    differ = [key for key in expected if key not in ("scale", "side") and weights.network.get(key) != expected[key]]
    if differ:
        got = ", ".join(f"{key} {weights.network.get(key)!r}" for key in differ)
        wanted = ", ".join(f"{key} {expected[key]!r}" for key in differ)
        raise MethodError(f"--weights {name}: expected a network of {wanted}, got {got}; --encoder chooses the network")


class Subset(LabelledDataset):
    """A subset of the images of a dataset, sharing its cache."""

    def __init__(self, whole: LabelledDataset, places: list[int], labelled: LabelledSet) -> None:
        super().__init__(labelled, whole.scale, whole.side)
        self._whole, self._places = whole, places

    def sample(self, index: int) -> Any:
        return self._whole.sample(self._places[index])


def run_cell(bench: Bench, cell: Cell, folder: Path, progress: Progress) -> list[ResultRecord]:
    """Return the records in a cell's folder, or train and score the cell. Raises ResultError where the records there
    are of other data or settings."""
    known = finished(bench, cell, folder)
    if known is not None:
        return known
    model = bench.train(cell, folder, progress)
    kept = dict(zip(_names(bench.truth), bench.predictions(model), strict=True))
    data = io.BytesIO()
    np.savez_compressed(data, **kept)  # type: ignore[arg-type]
    write_atomically(folder / PREDICTIONS, data.getvalue())
    found = score(bench.truth, (read_prediction(kept[name], mask.classes.shape) for name, mask in _pairs(bench.truth)))
    records = records_of(found, cell.variant, bench, cell, bench.identity(cell))
    write_results(folder / RESULT, records)
    return records


def finished(bench: Bench, cell: Cell, folder: Path) -> list[ResultRecord] | None:
    """Records of a cell in its folder; None where there are none yet."""
    return known_records(folder, bench.identity(cell))


def known_records(folder: Path, identity: Mapping[str, Any]) -> list[ResultRecord] | None:
    """Records in a folder; None where there are none yet. Raises ResultError where they are of another identity."""
    if not (folder / RESULT).is_file():
        return None
    records = read_results(folder / RESULT)
    if any(record.info.get("identity") != identity for record in records):
        raise ResultError(
            f"{folder}: holds a cell of other data or settings; --out chooses another folder, or remove this one"
        )
    return records


def read_prediction(kept: Any, shape: tuple[int, ...]) -> Prediction:
    """Convert stored logits (K, h, w) to a prediction at the native size (H, W)."""
    oyster, depth, *_ = probability(enlarged(kept.astype(np.float32) * STEP, *shape))
    found = find_instances(oyster, depth)
    return Prediction(oyster > 0.5, found.labels, found.scores)


def records_of(
    found: Score, method: str, bench: Bench, cell: Cell | None, identity: Mapping[str, Any]
) -> list[ResultRecord]:
    """Make a record for each test clip, and one for all of them, which has a line per image."""
    size = None if cell is None else cell.size
    amount = len(bench.real.train) if size == 0 else size
    return [
        ResultRecord(
            track="segmentation",
            split=bench.real.test.name,
            hidden=False,
            sequence=clip,
            method=method,
            method_settings={} if cell is None else {"real_images": amount or 0, "asked": size},
            seed=None if cell is None else cell.seed,
            run=0 if cell is None else cell.seed,
            metrics=metrics,
            reasons={key: text for key, text in found.reasons[clip].items() if key in metrics},
            evaluator_version=EVALUATORS,
            info={"identity": dict(identity), **({"images": list(found.images)} if clip == WHOLE else {})},
        )
        for clip, metrics in found.metrics.items()
    ]


def _names(truth: Truth) -> list[str]:
    return [mask.name for mask in truth.masks]


def _pairs(truth: Truth) -> Iterator[tuple[str, Any]]:
    return ((mask.name, mask) for mask in truth.masks)
