"""`oysterbench train moving`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from oysterbench_baselines.learning.trained import checkpoint_path, device_option, run_training, training_options


@click.command("moving", short_help="Detect moving objects, for SLAM to ignore.")
@training_options()
@device_option("auto")
def command(
    names: tuple[str, ...], out: Path | None, seed: int, steps: int, threads: int, device: str, again: bool
) -> None:
    """Train the network with which gtsam_vi[mask=moving] masks fish, crabs, plants and the tether.

    \b
    Examples:
      oysterbench train moving --data slam-train --steps 1500
      oysterbench train moving --data slam-train --data my-dive.mcap --out mine.pt

    Data is a split, which is rendered if missing, or a sequence file or a folder of them. Images in which nothing moves
    are skipped. May be interrupted, even killed: the same command resumes from the last checkpoint and gives the same
    weights.
    """
    from oysterbench.cli.labelled import open_training_data
    from oysterbench_baselines.moving.labels import moving_set
    from oysterbench_baselines.moving.training import MovingSettings
    from oysterbench_baselines.unet.training import train

    labelled = moving_set(open_training_data(names))
    settings = MovingSettings()
    settings = replace(settings, fit=replace(settings.fit, steps=steps, threads=threads))
    path = out or checkpoint_path("moving")
    run_training("moving", labelled, settings, train, path, seed, device, again)
