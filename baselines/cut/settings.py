"""Settings of the training of a translation: the methods, and the sizes for a CPU and for a GPU."""

from __future__ import annotations

from dataclasses import dataclass, replace

from oysterbench.core.errors import MethodError

NAMED_LAYERS = ("pixels", "conv1", "conv2")
"""Layers of the encoder before its residual blocks, which are block1, block2, ..."""


@dataclass(frozen=True)
class CutSettings:
    """Contrastive unpaired translation (Park et al. 2020).

    filters, blocks: of the generator; discriminator_filters: of its opponent; skip: the generator modifies its input
    instead of painting anew. crop: px of a training crop; scale: at which images are processed.
    layers: of the encoder, whose patches are compared; patches: locations compared in each; temperature: tau.
    nce_weight, identity: weight of PatchNCE, and whether it also ties real images to themselves; flip: whether mirrored
    images must be translated into mirrored ones.
    steps, learning_rate: of Adam with betas (0.5, 0.999), constant for the first half, then falling linearly to 0.
    """

    filters: int = 64
    blocks: int = 9
    discriminator_filters: int = 64
    skip: bool = False
    crop: int = 256
    scale: float = 1.0
    layers: tuple[str, ...] = ("pixels", "conv1", "conv2", "block1", "block5")
    patches: int = 256
    width: int = 256
    temperature: float = 0.07
    nce_weight: float = 1.0
    identity: bool = True
    flip: bool = False
    steps: int = 100_000
    learning_rate: float = 2e-4
    threads: int = 1

    def __post_init__(self) -> None:
        if self.crop % 4 or self.crop < 16:
            raise MethodError(f"crop = {self.crop}: expected a multiple of 4, and at least 16 px")
        if self.blocks < 1 or self.filters < 1 or self.steps < 1 or not 0 < self.scale <= 1:
            raise MethodError("blocks, filters and steps: expected at least 1; scale: above 0 and up to 1")
        known = (*NAMED_LAYERS, *(f"block{k + 1}" for k in range(self.blocks)))
        for layer in self.layers:
            if layer not in known:
                raise MethodError(
                    f"layer {layer!r}: a generator of {self.blocks} blocks has no such layer; it has {', '.join(known)}"
                )

    def rate(self, step: int) -> float:
        """Learning rate of a step: a function of its number alone, so that a resumed training uses the same."""
        half = self.steps / 2
        return self.learning_rate * min(1.0, (self.steps - step) / max(1.0, self.steps - half))


SIZES = {
    "full": CutSettings(),
    "small": CutSettings(
        filters=16, blocks=6, discriminator_filters=16, skip=True, crop=128, scale=0.5, steps=2_000, learning_rate=4e-4
    ),
}
"""As published, for a GPU; and a size that one CPU core trains in minutes."""


def settings_of(method: str, size: str, steps: int | None = None) -> CutSettings:
    """Settings of `cut` or `fastcut` in one of `SIZES`. FastCUT: no identity term, ten times the weight on PatchNCE,
    flip equivariance. Raises MethodError for any other name."""
    if size not in SIZES:
        raise MethodError(f"size {size!r}: expected one of {', '.join(SIZES)}")
    chosen = SIZES[size]
    if method == "fastcut":
        chosen = replace(chosen, nce_weight=10.0, identity=False, flip=True)
    elif method != "cut":
        raise MethodError(f"method {method!r}: expected cut or fastcut")
    return chosen if steps is None else replace(chosen, steps=steps)
