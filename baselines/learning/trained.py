"""Trainings as run by commands and used by methods: where checkpoints are kept, and the options that all share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.labelled import LABELLED
from oysterbench.core.errors import MethodError
from oysterbench.core.names import counted
from oysterbench.methods.weights import existing, weights_path, weights_variable
from oysterbench.methods.weights import used_path as used_by_default

if TYPE_CHECKING:
    from oysterbench.annotations import LabelledSet
    from oysterbench_baselines.learning.checkpoint import Checkpoint

LAST = 50
"""Number of final steps whose mean loss is reported at the end."""

seed_option = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
side_option = click.option(
    "--side",
    help="Of data that has sides, only images of this one; other data is used whole.  [default: train]",
)


def device_option(default: str) -> Callable[[Any], Any]:
    """Option for the device that a training runs on."""
    return click.option("--device", default=default, show_default=True, help="auto, cpu, cuda or cuda:N.")


def training_options(steps: int = 2000) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Options of a training that leaves one checkpoint for a method. steps: default number of steps."""
    number = click.IntRange(min=1)
    file = click.Path(path_type=Path, dir_okay=False)
    options = (
        click.option(
            "--again",
            is_flag=True,
            help="Start over, even where a training would resume. What is there is replaced at the end; without "
            "--again, an interrupted training resumes.",
        ),
        click.option(
            "--threads",
            type=number,
            default=2,
            show_default=True,
            help="CPU threads; the result depends on their number.",
        ),
        click.option("--steps", type=number, default=steps, show_default=True, help="Optimiser steps."),
        seed_option,
        click.option("--out", type=file, help="Checkpoint.  [default: under the home folder]"),
        click.option("--data", "names", type=LABELLED, multiple=True, required=True, help="Training data; repeatable."),
    )

    def decorated(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in options:
            command = option(command)
        return command

    return decorated


def checkpoint_path(name: str) -> Path:
    """Path of the checkpoint that `oysterbench train NAME` leaves: OYSTERBENCH_<NAME>, or by default in the folder of
    trained weights."""
    return Path(os.environ.get(weights_variable(name)) or weights_path(name))


def used_path(name: str, checkpoint: str = "") -> Path:
    """Path of the checkpoint that a method uses: the one given, else the one that OYSTERBENCH_<NAME> names, else one
    trained or downloaded here, else the one that is part of oysterbench."""
    return Path(checkpoint) if checkpoint else used_by_default(name)


def trained(name: str, checkpoint: str = "") -> Path:
    """Return `used_path` where the file exists. Raises MethodError, which says what to type, where it does not."""
    return existing(name, used_path(name, checkpoint))


@contextmanager
def on_torch(name: str) -> Iterator[None]:
    """Wrap a block that imports torch. Raises MethodError where torch is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise MethodError(f"{name}: {error}; it runs on PyTorch: pip install 'oysterbench[learn]'") from None


def run_training(
    name: str,
    labelled: LabelledSet,
    settings: Any,
    train: Callable[..., Checkpoint],
    path: Path,
    seed: int,
    device: str,
    again: bool,
) -> Checkpoint:
    """Run a training on labelled images for a command, with a progress bar for each stage, and report its end.

    train: a function like `unet.training.train`. again: start over, even if a checkpoint exists.
    """
    from oysterbench.cli.render import frames_bar
    from oysterbench_baselines.learning.loop import pick_device

    chosen = pick_device(device)
    with (
        frames_bar("reading", "images") as loading,
        frames_bar(f"training {name} on {len(labelled)} images", "steps") as progress,
        frames_bar("measuring", "images") as measuring,
    ):
        checkpoint = train(labelled, path, settings, seed, chosen, progress, loading, measuring, again=again)
    tell_end(checkpoint, path)
    return checkpoint


def tell_end(checkpoint: Checkpoint, path: Path) -> None:
    """Report the end of a training: steps, loss and time on stderr, the checkpoint's path on stdout."""
    last = checkpoint.losses[-LAST:]
    message(
        f"{counted(checkpoint.step, 'step')}, loss {sum(last) / len(last):.3f} over the last {len(last)}, "
        f"{checkpoint.seconds:.0f} CPU-seconds"
    )
    echo(path)
