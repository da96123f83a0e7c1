"""`oysterbench train segformer`, run in the environment of its build."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import click

from oysterbench.cli.echo import message
from oysterbench.core.helpers import module_command
from oysterbench.core.places import home
from oysterbench.methods.systems import find_system
from oysterbench_baselines.learning.trained import device_option, run_training, side_option, training_options


@click.command("segformer", short_help="SegFormer, from the package transformers, on any labelled images.")
@training_options()
@side_option
@click.option(
    "--size", type=click.Choice(["b0", "b1", "b2"]), default="b0", show_default=True, help="Size of the network."
)
@device_option("auto")
def command(
    names: tuple[str, ...],
    side: str | None,
    size: str,
    out: Path | None,
    seed: int,
    steps: int,
    threads: int,
    device: str,
    again: bool,
) -> None:
    """Train the published network SegFormer from random weights, for `oysterbench run segformer`.

    \b
    Examples:
      oysterbench systems build segformer
      oysterbench train segformer --data seg-train
      oysterbench train segformer --data seg-train --data my-masks --size b1 --out mine.pt
      oysterbench run "segformer[weights=mine.pt]" --split seg-val

    Data is as for `oysterbench train unet`. May be interrupted, even killed: the same command resumes from the last
    checkpoint and gives the same weights.
    """
    from oysterbench.methods.systems.building import interpreter

    system = find_system("segformer")
    python = interpreter(system)
    if not os.path.samefile(sys.prefix, python.parent.parent):
        os.execv(python, module_command("oysterbench", *sys.argv[1:], python=python))

    from oysterbench.cli.labelled import open_training_data
    from oysterbench_baselines.external.segformer.network import SegFormerSettings
    from oysterbench_baselines.external.segformer.training import TrainingSettings, train
    from oysterbench_baselines.unet.training import thresholds_of

    labelled = open_training_data(names, side)
    settings = TrainingSettings(network=SegFormerSettings(size=size))
    settings = replace(settings, fit=replace(settings.fit, steps=steps, threads=threads))
    path = out or home() / system.description.options["weights"].default
    checkpoint = run_training("segformer", labelled, settings, train, path, seed, device, again)
    message(thresholds_of(checkpoint))
