"""`oysterbench train cut`, `oysterbench translate cut` and the controls `translate reinhard` and `histogram`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.labelled import LABELLED
from oysterbench.core.names import counted
from oysterbench_baselines.learning.trained import device_option, seed_option, used_path

if TYPE_CHECKING:
    from oysterbench.annotations import LabelledImage, LabelledSet
    from oysterbench_baselines.cut.judge import Judge

SAMPLES = 4
"""Number of rows of a sample sheet."""
SHEETS = 20
"""Approximate number of sample sheets of a training."""

source_option = click.option(
    "--source", "sources", type=LABELLED, multiple=True, required=True, help="Labelled images; repeatable."
)
side_option = click.option(
    "--side", help="Only targets of this split in their manifest.csv.  [default: train, or without one all but test]"
)
clip_option = click.option(
    "--clip",
    "clips",
    multiple=True,
    metavar="NAME",
    help="Only targets of this clip, for one kind of water; repeatable.",
)


def judge_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options for the judge of whether labels still hold, and for the consequence of its verdict."""
    for option in (
        click.option(
            "--keep",
            type=click.FloatRange(0, 1),
            metavar="SHARE",
            help="Only images on which the judge's IoU is at least this share of that before, such as 0.8.  "
            "[default: all]",
        ),
        click.option(
            "--judge",
            type=click.Path(path_type=Path, dir_okay=False),
            metavar="FILE",
            help="Weights of `oysterbench train unet`, which say what has become of the oysters; unet for those that "
            "it runs on.",
        ),
    ):
        command = option(command)
    return command


@click.command("cut", short_help="Make rendered images look like real ones, without pairs.")
@source_option
@click.option("--target", required=True, type=LABELLED, metavar="PATH", help="Real images; their labels are not used.")
@side_option
@clip_option
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder of the training.")
@click.option("--method", default="fastcut", show_default=True, help="cut or fastcut.")
@click.option("--size", default="small", show_default=True, help="small, for a CPU; full, as published.")
@click.option("--steps", type=click.IntRange(min=1), help="Optimiser steps.  [default: by size]")
@seed_option
@device_option("cpu")
def train_command(
    sources: tuple[str, ...],
    target: str,
    side: str | None,
    clips: tuple[str, ...],
    out: Path,
    method: str,
    size: str,
    steps: int | None,
    seed: int,
    device: str,
) -> None:
    """Learn to translate rendered images into real ones: CUT and FastCUT (Park et al. 2020).

    \b
    Examples:
      oysterbench train cut --source seg-closeup --target real-oysters \\
        --clip closeup-b --clip closeup-c --out cut
      oysterbench train cut --source seg-train --target my-dives --method cut --size full \\
        --device auto --out cut-full
      oysterbench translate cut cut/checkpoint.pt --source seg-closeup --out translated

    Writes checkpoint.pt, losses.csv, losses.png and samples/, with sheets from some twenty steps. May be interrupted,
    even killed: the same command resumes from the last checkpoint and gives the same weights.
    """
    from oysterbench.cli.labelled import open_data, open_training_data
    from oysterbench.cli.render import frames_bar
    from oysterbench.simulation.gallery import write_picture
    from oysterbench_baselines.cut.settings import settings_of
    from oysterbench_baselines.cut.sheets import sample_sheet, write_curves
    from oysterbench_baselines.cut.training import curves, train
    from oysterbench_baselines.cut.translation import generator_of, translate
    from oysterbench_baselines.learning.checkpoint import Checkpoint
    from oysterbench_baselines.learning.loop import pick_device

    settings = settings_of(method, size, steps)
    rendered, real = open_training_data(sources), targets(open_data(target), side, clips)
    samples = [rendered[k * len(rendered) // SAMPLES] for k in range(min(SAMPLES, len(rendered)))]
    beside = [image.pixels for image in real]

    def keep(checkpoint: Checkpoint) -> None:
        write_curves(checkpoint, out)
        last = max((int(path.stem) for path in (out / "samples").glob("*.png")), default=0)
        if not checkpoint.finished and checkpoint.step < last + settings.steps / SHEETS:
            return
        generator = generator_of(checkpoint, str(out))[0].to(pick_device(device))
        found = [translate(generator, settings, image.pixels) for image in samples]
        write_picture(out / "samples" / f"{checkpoint.step:06d}.png", sample_sheet(samples, found, beside))

    with frames_bar(f"training {method} on {len(rendered)} and {len(real)} images", "steps") as bar:
        checkpoint = train(rendered, real, settings, out / "checkpoint.pt", seed, pick_device(device), bar, keep)
    last = curves(checkpoint)[-100:].mean(axis=0)
    message(
        f"{counted(checkpoint.step, 'step')}, looks {last[1]:.3f}, content {last[2]:.3f} over the last 100, "
        f"{checkpoint.seconds:.0f} CPU-seconds"
    )
    echo(out / "checkpoint.pt")


@click.command("cut", short_help="Translate with a trained generator.")
@click.argument("checkpoint", metavar="[CHECKPOINT]", required=False, type=click.Path(path_type=Path))
@source_option
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder to write.")
@judge_options
@device_option("cpu")
def cut_command(
    checkpoint: Path | None, sources: tuple[str, ...], out: Path, judge: Path | None, keep: float | None, device: str
) -> None:
    """Translate labelled images at their own size. Their labels stay; the error this causes is measured, printed, and
    written to drift.csv image by image.

    \b
    Examples:
      oysterbench translate cut cut/checkpoint.pt --source seg-closeup --out translated
      oysterbench translate cut --source seg-closeup --out translated
      oysterbench translate cut cut/checkpoint.pt --source seg-closeup --judge unet.pt \\
        --keep 0.8 --out translated

    Without CHECKPOINT, the weights of `oysterbench download cut` are used, and downloaded if a hub is set. A judge is a
    segmentation network that was trained on other images: it says how well it finds the labels before and after, which
    oysters it no longer sees, and where it sees new ones.
    """
    judging = _judge(judge, keep, device)
    from oysterbench.cli.labelled import open_all
    from oysterbench.cli.render import frames_bar
    from oysterbench.methods.weights import have_weights
    from oysterbench_baselines.cut.translation import load_generator, translated
    from oysterbench_baselines.learning.loop import pick_device

    if checkpoint is None:
        checkpoint = used_path("cut")
        have_weights({"cut": checkpoint}, message, frames_bar)
    generator, settings = load_generator(checkpoint)
    generator.to(pick_device(device))
    _write(open_all(sources), lambda images: translated(generator, settings, images), out, judging, keep)


def _recolour(name: str, how: str) -> click.Command:
    @click.command(name, short_help=f"Transfer colours by {how}, image by image, without training.")
    @source_option
    @click.option("--target", required=True, type=LABELLED, metavar="PATH", help="Real images to take colours from.")
    @side_option
    @clip_option
    @seed_option
    @click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder to write.")
    @judge_options
    def command(
        sources: tuple[str, ...],
        target: str,
        side: str | None,
        clips: tuple[str, ...],
        seed: int,
        out: Path,
        judge: Path | None,
        keep: float | None,
    ) -> None:
        judging = _judge(judge, keep)
        from oysterbench.cli.labelled import open_all, open_data
        from oysterbench_baselines.cut.colour import TRANSFERS, recoloured

        models = targets(open_data(target), side, clips)
        _write(open_all(sources), lambda images: recoloured(images, models, TRANSFERS[name], seed), out, judging, keep)

    command.help = f"""Give labelled images the colours of real ones ({name}): for each, a clip and then one of its
    images is drawn. No edge moves; this is the control that a learned translation has to beat.

    \b
    Example:
      oysterbench translate {name} --source seg-closeup --target real-oysters \\
        --clip closeup-b --out translated
    """
    return command


histogram_command = _recolour("histogram", "histogram matching")
reinhard_command = _recolour("reinhard", "Reinhard's method")


def targets(labelled: LabelledSet, side: str | None, clips: tuple[str, ...]) -> LabelledSet:
    """Select the real images that may be used: of `side`, or as `training_side` selects them, and only of some clips.

    Raises LabelError for a side or a clip that does not exist.
    """
    from oysterbench.cli.labelled import training_side
    from oysterbench.core.errors import LabelError

    chosen = training_side(labelled, side)
    for clip in clips:
        if clip not in chosen.clips:
            raise LabelError(f"--clip {clip}: {chosen.name} has the clips {', '.join(chosen.clips)}")
    return chosen.where(lambda entry: not clips or entry.clip in clips)


def _judge(weights: Path | None, keep: float | None, device: str = "cpu") -> Judge | None:
    """Load the judge that was asked for, before anything that takes long. Raises MethodError for weights that are
    missing, or not those of a segmentation network."""
    if weights is None:
        if keep is not None:
            raise click.UsageError("--keep goes by what a judge sees: expected --judge beside it")
        return None
    from oysterbench.cli.render import frames_bar
    from oysterbench.methods.weights import existing, have_weights
    from oysterbench_baselines.cut.judge import Judge
    from oysterbench_baselines.learning.loop import pick_device

    if weights != Path("unet"):  # of any of the U-Nets
        return Judge(existing("unet", weights), pick_device(device))
    have_weights({"unet": used_path("unet")}, message, frames_bar)
    return Judge(used_path("unet"), pick_device(device))


def _write(
    source: LabelledSet,
    change: Callable[[LabelledSet], Iterator[LabelledImage]],
    out: Path,
    judge: Judge | None,
    keep: float | None,
) -> None:
    """Write the images that `change` returns as a folder of masks, and report how far masks have drifted."""
    from oysterbench.cli.render import frames_bar
    from oysterbench_baselines.cut.writing import sentences, write_translated

    with frames_bar(f"translating {source.name}", "images") as bar:
        found = write_translated(source, change, out, judge, keep or 0.0, bar)
    for line in sentences(found):
        message(line)
    echo(out)
