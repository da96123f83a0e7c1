"""`oysterbench train unet`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click


@click.command("unet", short_help="A small U-Net, on any labelled images.")
@click.option("--data", "names", multiple=True, required=True, metavar="SPLIT|PATH", help="To train on; repeatable.")
@click.option("--side", help="Only images of this split of the data, as its manifest.csv names it, such as train.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Checkpoint.  [default: under the home]")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--steps", type=click.IntRange(min=1), help="Of the optimiser.  [default: 2000]")
@click.option("--threads", type=click.IntRange(min=1), default=2, show_default=True, help="Part of what repeats it.")
@click.option("--device", default="auto", show_default=True, help="auto, cpu, cuda or cuda:N.")
@click.option("--again", is_flag=True, help="Begin anew where a checkpoint is there already.")
def command(
    names: tuple[str, ...],
    side: str | None,
    out: Path | None,
    seed: int,
    steps: int | None,
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

    Data is a split, which is rendered where it is not there yet; a sequence file or a folder of them; or a folder with
    images/ and masks/ (PNG), labels/ (YOLO polygons) or one COCO file. May be interrupted, even killed: the same
    command goes on from the last checkpoint, to the same weights.
    """
    from oysterbench.annotations import joined
    from oysterbench.cli.labelled import open_data
    from oysterbench.cli.render import frames_bar
    from oysterbench_baselines.learning.loop import pick_device
    from oysterbench_baselines.unet.method import default_checkpoint
    from oysterbench_baselines.unet.training import Settings, train

    sets = [open_data(name) for name in names]
    if side is not None:
        sets = [one.of_split(side) for one in sets]
    labelled = sets[0] if len(sets) == 1 else joined(sets, "+".join(one.name for one in sets))
    settings = Settings()
    fit = dataclasses.replace(settings.fit, steps=steps or settings.fit.steps, threads=threads)
    path = out or default_checkpoint()
    if again:
        path.unlink(missing_ok=True)
    with (
        frames_bar("reading", "images") as loading,
        frames_bar(f"training unet on {len(labelled)} images", "steps") as progress,
    ):
        checkpoint = train(
            labelled,
            path,
            dataclasses.replace(settings, fit=fit),
            seed,
            pick_device(device),
            lambda done, total, loss: progress(done, total),
            loading,
        )
    last = checkpoint.losses[-50:]
    click.echo(
        f"{checkpoint.step} steps, loss {sum(last) / len(last):.3f} over the last {len(last)}, "
        f"{checkpoint.seconds:.0f} s of a processor",
        err=True,
    )
    click.echo(path)
