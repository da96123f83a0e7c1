"""`oysterbench train unet` and `oysterbench train unet_small`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oysterbench.core.errors import MethodError
from oysterbench.methods.weights import weights_names
from oysterbench_baselines.learning.trained import (
    checkpoint_path,
    device_option,
    run_training,
    side_option,
    trained,
    training_options,
)

if TYPE_CHECKING:
    from oysterbench_baselines.unet.training import UNetSettings


def begin_option(name: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Option for the initial weights of a training of this name."""
    return click.option(
        "--begin",
        metavar="MODEL|FILE",
        type=click.Path(path_type=Path, dir_okay=False),
        help=f"Initial weights: a file of another `oysterbench train {name}`, or {name}, for the current weights of "
        "that method.",
    )


@click.command("unet", short_help="A U-Net with a pretrained encoder, on any labelled images.")
@training_options(steps=1200)
@click.option(
    "--encoder",
    type=click.Choice(["lite0", "lite1", "lite2"]),
    help="EfficientNet-Lite pretrained on ImageNet, each a third more costly than the one before.  [default: lite0, or "
    "with --begin that of the weights]",
)
@begin_option("unet")
@side_option
@device_option("auto")
def command(
    names: tuple[str, ...],
    encoder: str | None,
    begin: Path | None,
    side: str | None,
    out: Path | None,
    seed: int,
    steps: int,
    threads: int,
    device: str,
    again: bool,
) -> None:
    """Train the methods unet and unet_instances, for `oysterbench run` and `oysterbench segment`.

    \b
    Examples:
      oysterbench train unet --data seg-train
      oysterbench train unet --data seg-train --data my-masks --out mine.pt
      oysterbench train unet --data seg-closeup --data seg-reefview --steps 400 --out rendered.pt
      oysterbench train unet --data my-masks --begin unet --steps 200 --out mine.pt

    Data is a split, which is rendered if missing; a sequence file or a folder of them; or a folder with images/ and
    masks/ (PNG), labels/ (YOLO polygons) or one COCO file. The last tenth of each camera's images of a clip, or by name
    where no clips are known, is held out to calibrate the network. May be interrupted, even killed: the same command
    resumes from the last checkpoint and gives the same weights. 1200 steps take about an hour on two cores, 100 minutes
    on one.
    """
    from oysterbench_baselines.unet.training import pretrained_settings

    _train(
        "unet",
        pretrained_settings(encoder or "lite0"),
        names,
        side,
        begin,
        out,
        seed,
        steps,
        threads,
        device,
        again,
        encoder,
    )


@click.command("unet_small", short_help="The same with a small network trained from random weights.")
@training_options()
@begin_option("unet_small")
@side_option
@device_option("auto")
def small_command(
    names: tuple[str, ...],
    begin: Path | None,
    side: str | None,
    out: Path | None,
    seed: int,
    steps: int,
    threads: int,
    device: str,
    again: bool,
) -> None:
    """Train the methods unet_small and unet_small_instances: half a million weights, trained from scratch.

    \b
    Examples:
      oysterbench train unet_small --data seg-train
      oysterbench train unet_small --data seg-train --data my-masks --out mine.pt

    Data is as for `oysterbench train unet`. Training resumes after interruption.
    """
    from oysterbench_baselines.unet.training import UNetSettings

    _train("unet_small", UNetSettings(), names, side, begin, out, seed, steps, threads, device, again)


def _train(
    name: str,
    settings: UNetSettings,
    names: tuple[str, ...],
    side: str | None,
    begin: Path | None,
    out: Path | None,
    seed: int,
    steps: int,
    threads: int,
    device: str,
    again: bool,
    encoder: str | None = None,
) -> None:
    """Train one of the networks on the data named by a command."""
    from oysterbench.cli.echo import message
    from oysterbench.cli.labelled import open_training_data
    from oysterbench_baselines.learning.checkpoint import read_finished
    from oysterbench_baselines.unet.model import check_kind
    from oysterbench_baselines.unet.training import begun_settings, thresholds_of, train

    path = out or checkpoint_path(name)
    if begin == Path(name) and not begin.exists():
        _check_out(path, begin, checkpoint_path(name))  # what the name means as soon as there is such a file
        begin = trained(name)
    if begin is not None and str(begin) in weights_names() and not begin.exists():
        raise MethodError(
            f"--begin {begin}: these are weights of another network; begin with a file of `oysterbench train {name}`, "
            f"or with {name}"
        )
    if begin is not None:
        _check_out(path, begin, begin)
    begun = None if begin is None else read_finished(begin)
    if begun is not None:
        check_kind(begun, name, begin)
        if encoder not in (None, begun.network["encoder"]):
            raise MethodError(
                f"{begin}: its encoder is {begun.network['encoder']}, and --encoder {encoder} is asked for: leave that "
                "out, or begin with weights of such a one"
            )
        settings = begun_settings(settings, begun)
    labelled = open_training_data(names, side)
    settings = replace(settings, fit=replace(settings.fit, steps=steps, threads=threads))
    checkpoint = run_training(name, labelled, settings, partial(train, begun=begun), path, seed, device, again)
    message(thresholds_of(checkpoint, begun))


def _check_out(path: Path, begin: Path, meant: Path) -> None:
    """Refuse to write checkpoints to the file that --begin names. Raises MethodError."""
    if path.resolve() == meant.resolve():
        raise MethodError(
            f"{path}: expected another file than that of --begin {begin}: checkpoints would take the place of the "
            "weights to begin with, and an interrupted training could not be resumed; choose another --out"
        )
