"""One cell: train, prediction, score, and leave what came of it in a folder of its own."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.annotations import LabelledSet
from oysterbench.core.errors import MethodError, ResultError
from oysterbench.core.files import locked, write_atomically
from oysterbench.core.streams import Streams
from oysterbench.results.records import ResultRecord, read_results, write_results
from oysterbench_baselines.learning.batches import Mixture, initial_seed, make_batch
from oysterbench_baselines.learning.checkpoint import Checkpoint
from oysterbench_baselines.learning.loop import Progress, fit, pick_device
from oysterbench_baselines.learning.losses import mask_loss
from oysterbench_baselines.learning.masks import MaskModel, enlarged, probability
from oysterbench_baselines.learning.samples import Floats, LabelledDataset
from oysterbench_baselines.sim2real.data import Real, drawn
from oysterbench_baselines.sim2real.scoring import EVALUATORS, WHOLE, Prediction, Score, Truth, score
from oysterbench_baselines.sim2real.settings import Cell, ExperimentSettings
from oysterbench_baselines.unet.instances import find_instances
from oysterbench_baselines.unet.model import described, unet_model
from oysterbench_baselines.unet.network import UNetworkSettings
from oysterbench_baselines.unet.training import new_network

RESULT, PREDICTIONS, CHECKPOINT, LOCK = "results.json", "predictions.npz", "checkpoint.pt", ".lock"
STEP = 0.1
"""Of a logit, to which predictions are kept: 2.5 % of a probability at most."""


Source = LabelledSet | Checkpoint
"""Of what comes before real images: synthetic ones, or weights that have been learnt on such."""


@dataclasses.dataclass
class Bench:
    """What all cells share; images that several cells see are read once.

    synthetic: by the names of cells. Raises MethodError for weights of another network than the settings'
    shared: folder of the trainings on synthetic images alone, which know nothing of the real ones, where several
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
        """The test images, read when they are first needed."""
        if self._truth is None:
            self._truth = Truth.of(self.real.test)
        return self._truth

    def steps(self, cell: Cell) -> int:
        """Of the training of a cell, without what it begins from; none where its weights are given."""
        return 0 if self._given(cell) else self.settings.fit_of(cell).steps

    def _given(self, cell: Cell) -> bool:
        return cell.size is None and cell.synthetic in self._weights

    def identity(self, cell: Cell) -> dict[str, Any]:
        """What decides the weights of a cell and what they are tested on, as plain values."""
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
        """Of the real images of a cell; empty where it has none."""
        if size is None:
            return ""
        if (size, seed) not in self._drawn:
            self._drawn[size, seed] = drawn(self.real.train, size, seed).digest()
        return self._drawn[size, seed]

    def train(self, cell: Cell, folder: Path, progress: Progress) -> MaskModel:
        """The trained network of a cell, from its checkpoint where there is one."""
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
        with locked(folder / LOCK):  # another process may be at it
            return self._trained(cell, folder, progress)

    def _trained_on(self, cell: Cell) -> dict[str, Any]:
        """The identity of a cell without what it is tested on."""
        identity = self.identity(cell)
        return {**identity, "data": {key: value for key, value in identity["data"].items() if key != "test"}}

    def _images(self, cell: Cell) -> Mixture:
        """What a cell itself is trained on, without what was before it (`Cell.begun`)."""
        batch, kept = self.settings.batch, self._kept(cell)
        synthetic = [self._datasets[cell.synthetic]] if kept else []
        if cell.size is None:
            return Mixture(synthetic, [kept])
        chosen = drawn(self.real.train, cell.size, cell.seed)
        real = Subset(self._train, [self._place[entry.name] for entry in chosen.entries], chosen)
        return Mixture([*synthetic, real], [kept, batch - kept] if kept else [batch])

    def _kept(self, cell: Cell) -> int:
        """Crops of a batch of a cell that are synthetic."""
        if cell.size is None:
            return self.settings.batch
        return self.settings.schedule.kept if cell.synthetic in self._datasets else 0

    def predictions(self, model: MaskModel) -> Iterator[Floats]:
        """(K, h, w) logits of each test image, at the working scale, to `STEP`."""
        for pixels in self.truth.pixels:
            yield np.clip(np.round(model.small_logits(pixels) / STEP), -127, 127).astype(np.int8)


def _check_network(name: str, weights: Checkpoint, settings: UNetworkSettings) -> None:
    """Raises MethodError for weights of another network; pictures may have been of another size to it."""
    expected = described(settings)
    differ = [key for key in expected if key not in ("scale", "side") and weights.network.get(key) != expected[key]]
    if differ:
        got = ", ".join(f"{key} {weights.network.get(key)!r}" for key in differ)
        wanted = ", ".join(f"{key} {expected[key]!r}" for key in differ)
        raise MethodError(f"--weights {name}: expected a network of {wanted}, got {got}; --encoder chooses the network")


class Subset(LabelledDataset):
    """Some images of a dataset, which keeps them."""

    def __init__(self, whole: LabelledDataset, places: list[int], labelled: LabelledSet) -> None:
        super().__init__(labelled, whole.scale, whole.side)
        self._whole, self._places = whole, places

    def sample(self, index: int) -> Any:
        return self._whole.sample(self._places[index])


def run_cell(bench: Bench, cell: Cell, folder: Path, progress: Progress) -> list[ResultRecord]:
    """The records of a cell: those in its folder, or new ones. Raises ResultError where these are of something else."""
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
    """The records in a folder; None where there are none yet."""
    return known_records(folder, bench.identity(cell))


def known_records(folder: Path, identity: Mapping[str, Any]) -> list[ResultRecord] | None:
    """The records in a folder; None where there are none yet. Raises ResultError where they are of something else."""
    if not (folder / RESULT).is_file():
        return None
    records = read_results(folder / RESULT)
    if any(record.info.get("identity") != identity for record in records):
        raise ResultError(
            f"{folder}: holds a cell of other data or settings; --out chooses another folder, or remove this one"
        )
    return records


def read_prediction(kept: Any, shape: tuple[int, ...]) -> Prediction:
    """What kept logits (K, h, w) say at the native size (H, W)."""
    oyster, depth, *_ = probability(enlarged(kept.astype(np.float32) * STEP, *shape))
    found = find_instances(oyster, depth)
    return Prediction(oyster > 0.5, found.labels, found.scores)


def records_of(
    found: Score, method: str, bench: Bench, cell: Cell | None, identity: Mapping[str, Any]
) -> list[ResultRecord]:
    """A record for each test clip, and one of all of them, which has a line per image."""
    size = None if cell is None else cell.size
    amount = len(bench.real.train) if size == 0 else size
    return [
        ResultRecord(
            track="segmentation",
            split=bench.real.test.name,
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
