"""`oysterbench train unet`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from oysterbench_baselines.learning.trained import checkpoint_path, device_option, run_training, training_options


@click.command("unet", short_help="A U-Net, small or on a pretrained encoder, on any labelled images.")
@training_options
@click.option(
    "--encoder",
    type=click.Choice(["none", "lite0", "lite1", "lite2"]),
    default="none",
    show_default=True,
    help="EfficientNet-Lite that has learnt on ImageNet, for the way down; none: a small one, of random weights.",
)
@click.option("--side", help="Only images of this split of the data, as its manifest.csv names it, such as train.")
@device_option("auto")
def command(
    names: tuple[str, ...],
    encoder: str,
    side: str | None,
    out: Path | None,
    seed: int,
    steps: int,
    threads: int,
    device: str,
    again: bool,
) -> None:
    """Train the method unet, which `oysterbench run unet` then uses.

    \b
    Examples:
      oysterbench train unet --data seg-train
      oysterbench train unet --data seg-train --data my-masks --out mine.pt
      oysterbench train unet --data real-oysters --side train --steps 1000
      oysterbench train unet --encoder lite0 --data seg-train --steps 1000

    Data is a split, which is rendered where it is not there yet; a sequence file or a folder of them; or a folder with
    images/ and masks/ (PNG), labels/ (YOLO polygons) or one COCO file. May be interrupted, even killed: the same
    command goes on from the last checkpoint, to the same weights.
    """
    from oysterbench.cli.labelled import open_all
    from oysterbench_baselines.unet.training import UNetSettings, pretrained_settings, train

    labelled = open_all(names, side)
    settings = UNetSettings() if encoder == "none" else pretrained_settings(encoder)
    settings = replace(settings, fit=replace(settings.fit, steps=steps, threads=threads))
    path = out or checkpoint_path("unet")
    run_training("unet", labelled, settings, train, path, seed, device, again)
