"""`oysterbench train gtsam_vi_learned`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from oysterbench_baselines.learning.trained import checkpoint_path, tell_end, training_options


@click.command("gtsam_vi_learned", short_help="The learned front end of gtsam_vi, on rendered dives.")
@training_options()
@click.option("--sequence", "wanted", multiple=True, metavar="NAME", help="Only this sequence; repeatable.")
def command(
    names: tuple[str, ...],
    wanted: tuple[str, ...],
    out: Path | None,
    seed: int,
    steps: int,
    threads: int,
    again: bool,
) -> None:
    """Train the front end of the method gtsam_vi_learned, for `oysterbench run gtsam_vi_learned`.

    \b
    Examples:
      oysterbench train gtsam_vi_learned --data slam-train
      oysterbench train gtsam_vi_learned --data slam-train --sequence train-02 \\
        --sequence train-05 --sequence train-08
      oysterbench train gtsam_vi_learned --data my-dives --steps 500 --out mine.pt

    Data is a split of the track slam, which is rendered if missing, a sequence file, or a folder of them. Only rendered
    data works, since ground-truth depth and motion give each image point's position in the other images. May be
    interrupted, even killed: the same command resumes from the last checkpoint and gives the same weights.
    """
    from oysterbench.cli.render import frames_bar
    from oysterbench_baselines.gtsam_vi_learned.correspondence import files_of, read_footage
    from oysterbench_baselines.gtsam_vi_learned.pairs import NAME
    from oysterbench_baselines.gtsam_vi_learned.training import MapTrainingSettings, train

    settings = MapTrainingSettings()
    settings = replace(settings, fit=replace(settings.fit, steps=steps, threads=threads))
    path = out or checkpoint_path(NAME)
    files = [file for name in names for file in files_of(name, wanted)]
    with frames_bar("reading", "sequences") as loading:
        footages = read_footage(files, loading)
    with frames_bar(f"training {NAME} on {len(footages)} sequences", "steps") as progress:
        checkpoint = train(footages, path, settings, seed, progress, again)
    tell_end(checkpoint, path)
