"""`oysterbench train steering`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from oysterbench.cli.echo import message
from oysterbench_baselines.learning.trained import checkpoint_path, tell_end, training_options


def _renamed(context: click.Context, parameter: click.Parameter, value: float | None) -> None:
    if value is not None:
        raise click.UsageError("--dive-s is named --rollout-s now")


@click.command("steering", short_help="A small network that steers, trained on an expert's commands.")
@training_options()
@click.option("--val", metavar="SPLIT|PATH", help="Data to validate on after training.")
@click.option("--dagger", "rounds", type=click.IntRange(min=0), default=0, metavar="ROUNDS", help="Rounds of DAgger.")
@click.option(
    "--rollout-s", type=click.FloatRange(min=1), help="Length of a DAgger rollout, in s.  [default: the task's]"
)
@click.option("--dive-s", type=float, hidden=True, expose_value=False, callback=_renamed)
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes for rollouts.")
def command(
    names: tuple[str, ...],
    val: str | None,
    out: Path | None,
    seed: int,
    steps: int,
    threads: int,
    rounds: int,
    rollout_s: float | None,
    workers: int,
    again: bool,
) -> None:
    """Train the method steering; `oysterbench eval --track steering --method steering` then evaluates it.

    \b
    Examples:
      oysterbench train steering --data steer-train --val steer-val
      oysterbench train steering --data steer-train --dagger 3 --workers 2
      oysterbench train steering --data steer-mini --steps 200 --out mine.pt

    Data is a split of the track steering, which is rendered if missing, a sequence file, or a folder of them. With
    --dagger ROUNDS, each round rolls the network out over the reefs of the data, labels the rollouts with the expert's
    commands, and continues training on them as well. May be interrupted, even killed: the same command, without
    --again, resumes from the last checkpoint and the last finished rollout, and gives the same weights.
    """
    from oysterbench.cli.render import frames_bar
    from oysterbench_baselines.steering.dagger import Rounds, learn_rounds, reef_of
    from oysterbench_baselines.steering.examples import files_of, read_all
    from oysterbench_baselines.steering.model import SteeringModel
    from oysterbench_baselines.steering.scoring import score
    from oysterbench_baselines.steering.training import SteeringSettings, train

    settings = SteeringSettings()
    settings = replace(settings, fit=replace(settings.fit, steps=steps, threads=threads))
    path = out or checkpoint_path("steering")
    files = [file for name in names for file in files_of(name)]
    with frames_bar("reading", "sequences") as loading:
        examples = read_all(files, settings.network, loading)
    if rounds:
        reefs, plan = [reef_of(file) for file in files], Rounds(rounds, rollout_s)
        checkpoint = learn_rounds(examples, reefs, path, settings, plan, seed, workers, frames_bar, again)
    else:
        with frames_bar(f"training steering on {len(examples)} views", "steps") as progress:
            checkpoint = train(examples, path, settings, seed, progress, again=again)
    if val is not None:
        unseen = read_all(files_of(val), settings.network)
        message(f"{val}: {score(SteeringModel.of(checkpoint), unseen)}")
    tell_end(checkpoint, path)
