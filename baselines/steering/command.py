"""`oysterbench train steering`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click


@click.command("steering", short_help="A small network that steers, on what an expert would do.")
@click.option("--data", "names", multiple=True, required=True, metavar="SPLIT|PATH", help="To train on; repeatable.")
@click.option("--val", "val", metavar="SPLIT|PATH", help="To say afterwards how good it is on what it has not seen.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Checkpoint.  [default: under the home]")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--steps", type=click.IntRange(min=1), help="Of the optimiser.  [default: 2000]")
@click.option("--threads", type=click.IntRange(min=1), default=2, show_default=True, help="Part of what repeats it.")
@click.option("--dagger", "rounds", type=click.IntRange(min=0), default=0, metavar="ROUNDS", help="Dive and learn on.")
@click.option("--dive-s", type=click.FloatRange(min=1), help="Of a dive of DAgger, s.  [default: the task's]")
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes that dive.")
@click.option("--again", is_flag=True, help="Begin anew where a checkpoint is there already.")
def command(
    names: tuple[str, ...],
    val: str | None,
    out: Path | None,
    seed: int,
    steps: int | None,
    threads: int,
    rounds: int,
    dive_s: float | None,
    workers: int,
    again: bool,
) -> None:
    """Train the method steering, which `oysterbench eval --track steering --method steering` then measures.

    \b
    Examples:
      oysterbench train steering --data steer-train --val steer-val
      oysterbench train steering --data steer-train --dagger 3 --workers 2
      oysterbench train steering --data steer-mini --steps 200 --out mine.pt

    Data is a split of the track steering, which is rendered where it is not there yet, a sequence file, or a folder of
    them. --dagger ROUNDS: in each round the network dives over the reefs of the data, the expert says what it would
    have done, and it is trained further on that, too. May be interrupted, even killed: the same command goes on from
    the last checkpoint and the last finished dive, to the same weights.
    """
    import shutil

    from oysterbench.cli.render import frames_bar
    from oysterbench_baselines.steering.dagger import Rounds, learn_rounds, reef_of
    from oysterbench_baselines.steering.lessons import files_of, read_all
    from oysterbench_baselines.steering.method import default_checkpoint
    from oysterbench_baselines.steering.model import Model
    from oysterbench_baselines.steering.scoring import score
    from oysterbench_baselines.steering.training import Settings, train

    settings = Settings()
    fit = dataclasses.replace(settings.fit, steps=steps or settings.fit.steps, threads=threads)
    settings = dataclasses.replace(settings, fit=fit)
    path = out or default_checkpoint()
    if again:
        path.unlink(missing_ok=True)
        shutil.rmtree(path.with_suffix(".rounds"), ignore_errors=True)
    files = [file for name in names for file in files_of(name)]
    with frames_bar("reading", "sequences") as loading:
        lessons = read_all(files, settings.network, loading)
    if rounds:
        reefs = [reef_of(file) for file in files]
        checkpoint = learn_rounds(lessons, reefs, path, settings, Rounds(rounds, dive_s), seed, workers, frames_bar)
    else:
        with frames_bar(f"training steering on {len(lessons)} views", "steps") as progress:
            checkpoint = train(lessons, path, settings, seed, lambda done, total, loss: progress(done, total))
    last = checkpoint.losses[-50:]
    click.echo(
        f"{checkpoint.step} steps, loss {sum(last) / len(last):.3f} over the last {len(last)}, "
        f"{checkpoint.seconds:.0f} s of a processor",
        err=True,
    )
    if val is not None:
        unseen = read_all(files_of(val), settings.network)
        click.echo(f"{val}: {score(Model.of(checkpoint), unseen)}", err=True)
    click.echo(path)
