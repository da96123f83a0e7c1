"""Settings of the experiment: which trainings it has, and how each is done, all with the same number of steps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from oysterbench.annotations.duplicates import MIN_CORRELATION
from oysterbench_baselines.learning.augment import Augmentation
from oysterbench_baselines.learning.loop import FitSettings
from oysterbench_baselines.unet.network import UNetworkSettings
from oysterbench_baselines.unet.training import BEGUN_SHARE, pretrained_settings

ALL = 0
"""Size that stands for all real training images."""

REAL = "real"
"""Name of the variant that sees real images only."""


@dataclass(frozen=True)
class Schedule:
    """Order of synthetic and real images in a training: first synthetic ones alone.

    share: of the steps, the last ones, that see real images; rate: learning rate of these; kept: crops in each of their
    batches that remain synthetic, so that what was learnt from those is not forgotten; start: share of the weights
    learnt from synthetic images in the final weights (`FitSettings.start`)
    """

    share: float
    rate: float
    kept: int
    start: float = 0.0


SCHEDULES = {"tuned": Schedule(1 / 6, 2e-3, 0), "mixed": Schedule(1 / 2, 5e-3, 2)}

PRETRAINED_STEPS, PRETRAINED_TUNED = 464, 64
"""Steps of networks with a pretrained encoder, and the last ones of these, that see real images after synthetic ones:
400 steps on synthetic images are worth 0.05 in IoU on real ones more than 115, on training clips held out."""
PRETRAINED_SIDE, PRETRAINED_CROP = 256, 160
"""Size of images and of crops, px: smaller than in `train unet`, as many networks are trained. Real images alone are
worth as much as at 320 px and 224 px, in half the time."""
PRETRAINED_SHARE, PRETRAINED_RATE = PRETRAINED_TUNED / PRETRAINED_STEPS, 1e-3
"""`Schedule.share` and `rate` for networks with a pretrained encoder, which need fewer and smaller steps."""


@dataclass(frozen=True)
class ExperimentSettings:
    """Settings of the experiment.

    sizes:       numbers of real training images; `ALL` for all
    seeds:       number of trainings of each kind; seed k draws the real images, the weights and the crops
    batch:       crops per step
    schedule:    for real + synthetic: one of `SCHEDULES`
    block:       number of neighbouring test images that are resampled together
    similarity:  correlation with a test image at which a training image is left out
    """

    sizes: tuple[int, ...] = (5, 10, 20, 40, ALL)
    seeds: int = 3
    batch: int = 8
    schedule: Schedule = SCHEDULES["tuned"]
    block: int = 8
    similarity: float = MIN_CORRELATION
    network: UNetworkSettings = field(default_factory=lambda: UNetworkSettings(base=8, scale=0.2))
    augmentation: Augmentation = field(default_factory=lambda: Augmentation(crop=56))
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=1200, warm_up=20, threads=1))

    def with_encoder(self, encoder: str) -> ExperimentSettings:
        """Return the same experiment with networks with a pretrained encoder (`unet.training.pretrained_settings`), on
        smaller images."""
        strong = pretrained_settings(encoder)
        return replace(
            self,
            batch=strong.batch,
            schedule=replace(self.schedule, share=PRETRAINED_SHARE, rate=PRETRAINED_RATE),
            network=replace(strong.network, side=PRETRAINED_SIDE),
            augmentation=replace(strong.augmentation, crop=PRETRAINED_CROP),
            fit=replace(strong.fit, steps=PRETRAINED_STEPS, warm_up=20, threads=1),
        )

    def for_other_sites(self) -> ExperimentSettings:
        """Return the same experiment with all real images, for tests on sites that they do not show: there the mean of
        the weights learnt from synthetic images and the last ones holds up better than the last ones, which are better
        on sites that they do show."""
        start = BEGUN_SHARE if self.network.encoder else self.schedule.start
        return replace(self, sizes=(ALL,), schedule=replace(self.schedule, start=start))

    def fit_of(self, cell: Cell) -> FitSettings:
        """Optimiser settings of a cell's own training, without the one it starts from (`Cell.begun`)."""
        tuned = round(self.schedule.share * self.fit.steps)
        if cell.begun is not None:
            return replace(self.fit, steps=tuned, learning_rate=self.schedule.rate, start=self.schedule.start)
        return replace(self.fit, steps=self.fit.steps - tuned) if cell.synthetic else self.fit


@dataclass(frozen=True)
class Cell:
    """One training. synthetic: name of the synthetic images, or of weights trained on such, empty for none; size:
    number of real images, None for none."""

    synthetic: str
    size: int | None
    seed: int

    @property
    def variant(self) -> str:
        """Description in words, without size and seed."""
        if not self.synthetic:
            return REAL
        return f"{self.synthetic} only" if self.size is None else f"{REAL} + {self.synthetic}"

    @property
    def begun(self) -> Cell | None:
        """The cell from whose weights it starts: that of its synthetic images alone. None: it starts from the weights
        of ImageNet, or from random ones."""
        return Cell(self.synthetic, None, self.seed) if self.synthetic and self.size is not None else None

    @property
    def folder(self) -> str:
        """Name of the cell's folder."""
        size = "none" if self.size is None else "all" if self.size == ALL else f"{self.size:03d}"
        return f"{self.synthetic or REAL}-real-{size}-seed-{self.seed}"


def cells_of(synthetic: tuple[str, ...], settings: ExperimentSettings) -> list[Cell]:
    """Cells of the experiment, seed by seed, so that an interrupted experiment has some of every kind."""
    found = []
    for seed in range(settings.seeds):
        found += [Cell(name, None, seed) for name in synthetic]
        for size in settings.sizes:
            found += [Cell(name, size, seed) for name in ("", *synthetic)]
    return found
