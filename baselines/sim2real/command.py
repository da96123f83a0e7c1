"""`oysterbench experiment sim2real`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import click

from oysterbench.cli.labelled import LABELLED
from oysterbench.methods.weights import weights_names
from oysterbench_baselines.learning.trained import device_option, trained


@click.command("sim2real", short_help="What rendered images add to real ones.")
@click.option(
    "--real",
    required=True,
    type=LABELLED,
    metavar="PATH",
    help="Labelled real images, with manifest.csv: clip and split.",
)
@click.option(
    "--synthetic",
    "names",
    multiple=True,
    metavar="NAME=SPLIT|PATH",
    help="Synthetic images; those with one NAME form one set.",
)
@click.option(
    "--weights",
    "given",
    multiple=True,
    metavar="NAME=MODEL|FILE",
    help="Weights that were trained on synthetic images before: a file of `oysterbench train unet`, or unet for those "
    "that it runs on; repeatable.",
)
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder.  [default: under the home folder]"
)
@click.option(
    "--sizes",
    default="0,5,10,20,40,all",
    show_default=True,
    help="Numbers of real training images; 0, synthetic images alone, is always among them.",
)
@click.option("--seeds", type=click.IntRange(min=1), default=3, show_default=True, help="Training runs of each kind.")
@click.option(
    "--steps",
    type=click.IntRange(min=1),
    help="Optimiser steps of each training run.  [default: 1200, or with --encoder 464]",
)
@click.option(
    "--schedule",
    default="tuned",
    show_default=True,
    help="For real + synthetic: tuned (synthetic images, then a sixth of the steps on real ones) or mixed (half of the "
    "steps, a quarter of each batch stays synthetic).",
)
@click.option(
    "--encoder",
    type=click.Choice(["none", "lite0", "lite1", "lite2"]),
    default="none",
    show_default=True,
    help="Pretrained encoder of the networks.",
)
@click.option("--leave-site-out", is_flag=True, help="Test on each site in turn, trained on all others.")
@click.option("--hold-out", multiple=True, metavar="CLIP", help="Test on this training clip instead; repeatable.")
@device_option("auto")
@click.option("--only-table", is_flag=True, help="Train nothing; summarise finished runs.")
def command(
    real: str,
    names: tuple[str, ...],
    given: tuple[str, ...],
    out: Path | None,
    sizes: str,
    seeds: int,
    steps: int | None,
    schedule: str,
    encoder: str,
    leave_site_out: bool,
    hold_out: tuple[str, ...],
    device: str,
    only_table: bool,
) -> None:
    """Train on few and many real images, with and without synthetic ones, and test on separate real clips.

    \b
    Examples:
      oysterbench experiment sim2real --real real-oysters --synthetic rendered=seg-train
      oysterbench experiment sim2real --real real-oysters --synthetic rendered=seg-train \\
        --synthetic colour=translated/colour --synthetic cut=translated/cut --out sim2real
      oysterbench experiment sim2real --real real-oysters --synthetic rendered=seg-train \\
        --hold-out closeup-b --hold-out closeup-c --sizes 10    to choose settings without the test clips
      oysterbench experiment sim2real --real real-oysters --synthetic rendered=seg-train --encoder lite0 \\
        --leave-site-out
      oysterbench experiment sim2real --real real-oysters --weights released=unet --encoder lite0 --seeds 5

    For each number of real images and each seed, it trains on real only and on real + each synthetic set; it also
    trains on each synthetic set alone. With --weights the first part of the training has been done already, and only
    real images follow. Translated images are a folder with images/, masks/ and, where known, instances/. Each training
    run has a folder with its checkpoint, its predictions and results.json. Sites are clips that show one place, as
    found from their images; --leave-site-out uses all real images of the other sites. May be interrupted, even killed:
    the same command resumes; started twice, both share the work. Training images that nearly duplicate test images are
    named and left out.
    """
    from oysterbench.cli.labelled import named_files, named_places, open_data, open_training_data

    parts = named_places(names, ["real"])
    weights = named_files(given, ["real", *parts])
    # The following imports load torch: arguments are checked first, so that a typing error is reported at once.
    from oysterbench.cli.echo import message
    from oysterbench.cli.outputs import print_rich
    from oysterbench.cli.render import frames_bar
    from oysterbench.core.places import home
    from oysterbench.report.renderers import terminal_table
    from oysterbench_baselines.learning.checkpoint import read_finished
    from oysterbench_baselines.sim2real.experiment import run, run_sites
    from oysterbench_baselines.sim2real.settings import SCHEDULES, ExperimentSettings
    from oysterbench_baselines.sim2real.work import Source

    sets = {name: open_training_data(places, name=name) for name, places in parts.items()}
    sources: dict[str, Source] = {**sets, **{name: read_finished(_file(path)) for name, path in weights.items()}}
    if schedule not in SCHEDULES:
        raise click.UsageError(f"--schedule: expected one of {', '.join(SCHEDULES)}, got {schedule!r}")
    if leave_site_out and hold_out:
        raise click.UsageError("--leave-site-out holds out each site in turn: expected no --hold-out beside it")
    settings = ExperimentSettings(sizes=_sizes(sizes), seeds=seeds, schedule=SCHEDULES[schedule])
    if encoder != "none":
        settings = settings.with_encoder(encoder)
    if steps is not None:
        settings = dataclasses.replace(settings, fit=dataclasses.replace(settings.fit, steps=steps))
    how: dict[str, Any] = {
        "device": device,
        "train": not only_table,
        "bar": frames_bar,
        "echo": message,
        "show": lambda table: print_rich(terminal_table(table)),
    }
    experiments = home() / "experiments"
    if leave_site_out:
        run_sites(open_data(real), sources, settings, out or experiments / "sim2real-sites", **how)
    else:
        run(open_data(real), sources, settings, out or experiments / "sim2real", hold_out=hold_out, **how)


def _file(weights: Path) -> Path:
    """Path of weights that are given as a file, or by the name under which a method runs on them."""
    by_name = str(weights) in weights_names() and not weights.exists()
    return trained(str(weights)) if by_name else weights


def _sizes(text: str) -> tuple[int, ...]:
    """Parse the numbers of real images; in the result, 0 stands for all, and that of synthetic images alone, which are
    trained on anyway, is left out. Raises UsageError for anything else."""
    words = [word.strip() for word in text.split(",")]
    if not all(word == "all" or word.isdecimal() for word in words):
        raise click.UsageError(f"--sizes: expected whole numbers, and all, with commas, got {text!r}")
    return tuple(dict.fromkeys(0 if word == "all" else int(word) for word in words if word.strip("0")))
