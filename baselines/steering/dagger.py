"""DAgger (Ross, Gordon & Bagnell 2011, algorithm 3.1): the policy is rolled out, the expert states what it would have
done, and training continues on the old and the new examples together. So training examples include places to which the
policy's own mistakes lead.

Everything is kept beside the checkpoint: each finished rollout in a file, each finished round in a checkpoint, from
which a killed training resumes.
"""

from __future__ import annotations

import dataclasses
import filecmp
import io
import json
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.cli.interrupts import started_over
from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import LabelError, MethodError
from oysterbench.exploration.rollout_store import steering_source
from oysterbench.recipe import SplitRecipe
from oysterbench.sequence import open_sequence
from oysterbench.simulation.generate import PROGRAM
from oysterbench.simulation.scheduling import run_here, run_in_processes
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint
from oysterbench_baselines.steering.examples import TrainingExamples, joined, recipe_of, senses_of, small
from oysterbench_baselines.steering.memory import Memory
from oysterbench_baselines.steering.network import SteeringNetworkSettings
from oysterbench_baselines.steering.training import SteeringSettings, identity, train

Bar = Callable[[str, str], AbstractContextManager[Callable[[int, int], None]]]
"""Creates a progress bar from a title and a unit; the bar is called with the number done and the total
(`oysterbench.cli.render.frames_bar`)."""


@contextmanager
def silent(title: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Progress bar that shows nothing."""
    yield lambda done, total: None


@dataclass(frozen=True)
class Rounds:
    """Plan of the rounds. rounds: their number. seconds: length of a rollout; None: the task's own. beta: share of the
    expert's commands in the first round, squared in the second, and so on. steps, learning_rate: of each round's
    training, which starts from the weights of the one before."""

    rounds: int = 0
    seconds: float | None = None
    beta: float = 0.5
    steps: int = 600
    learning_rate: float = 1e-3

    def mixture(self, number: int) -> float:
        """Share of the expert's commands in a round, numbered from 1."""
        return self.beta**number


@dataclass(frozen=True)
class Reef:
    """The reef of a rollout, given by a sequence of a split."""

    split: SplitRecipe
    name: str


def reef_of(path: Path) -> Reef:
    """Reef over which a sequence file was recorded."""
    return Reef(recipe_of(path), open_sequence(path).name)


def learn_rounds(
    examples: TrainingExamples,
    reefs: Sequence[Reef],
    path: Path,
    settings: SteeringSettings,
    plan: Rounds,
    seed: int,
    workers: int = 1,
    bar: Bar = silent,
    again: bool = False,
) -> Checkpoint:
    """Train on examples, then roll out over the reefs and train further, round by round; return the checkpoint of the
    last round, which is also at `path`.

    bar: creates progress bars. again: start over, without the rounds that are there; `path` is replaced at the end, and
    if this was interrupted, a call without `again` resumes. Raises MethodError where `path` or a file beside it is of
    another training, or two reefs have one name, by which their rollouts are kept; LabelError for reefs of a hidden
    split, whose ground truth is not available.
    """
    for reef in reefs:
        if reef.split.hidden:
            raise LabelError(f"{reef.split.name}: expected reefs to learn on, got those of a hidden split")
    for name, count in Counter(reef.name for reef in reefs).items():
        if count > 1:
            raise MethodError(f"reefs of the rounds: expected each name once, got {name!r} {count} times")
    folder = path.with_suffix(".rounds")
    known: dict[str, Any] = {examples.name: examples.digest()}
    replaced = folder / "replaced.pt"  # what `again` was asked to replace
    if again:
        shutil.rmtree(folder, ignore_errors=True)
        if path.is_file():
            write_atomically(replaced, path.read_bytes())
        started_over()
    elif path.is_file() and not (replaced.is_file() and filecmp.cmp(path, replaced, shallow=False)):
        further = (folder / f"round-{number}.pt" for number in range(1, plan.rounds + 1))
        own = [identity(settings, known, seed), *(read_checkpoint(one).identity for one in further if one.is_file())]
        if read_checkpoint(path).identity not in own:
            raise MethodError(
                f"{path}: holds another training, or more rounds of this one; remove it to train anew, or choose "
                "another --out"
            )
    parts = [examples]
    checkpoint = _trained(parts, folder / "round-0.pt", settings, seed, None, known, bar)
    fit = dataclasses.replace(settings.fit, steps=plan.steps, learning_rate=plan.learning_rate)
    for number in range(1, plan.rounds + 1):
        parts += collect(reefs, checkpoint, folder, settings.network, plan, number, workers, bar)
        known = {**known, f"rollouts of round {number}": joined(parts[-len(reefs) :]).digest()}
        changed = dataclasses.replace(settings, fit=fit)
        checkpoint = _trained(parts, folder / f"round-{number}.pt", changed, seed + number, checkpoint, known, bar)
    if not (path.is_file() and _same(read_checkpoint(path), checkpoint)):  # else results name the file that is there
        checkpoint.write(path)
    return checkpoint


def _same(one: Checkpoint, other: Checkpoint) -> bool:
    """Whether two checkpoints are of one training, and hold the same weights."""
    return one.identity == other.identity and one.digest() == other.digest()


def _trained(
    parts: Sequence[TrainingExamples],
    path: Path,
    settings: SteeringSettings,
    seed: int,
    begun: Checkpoint | None,
    known: Mapping[str, Any],
    bar: Bar,
) -> Checkpoint:
    examples = joined(parts)
    with bar(f"{path.stem}: training on {len(examples)} views", "steps") as told:
        return train(examples, path, settings, seed, told, begun, known)


def collect(
    reefs: Sequence[Reef],
    policy: Checkpoint,
    folder: Path,
    network: SteeringNetworkSettings,
    plan: Rounds,
    number: int,
    workers: int = 1,
    bar: Bar = silent,
) -> list[TrainingExamples]:
    """Collect the examples of a round's rollouts, one over each reef; rollouts whose files exist already are read.

    Raises MethodError where the round has been trained on rollouts other than these.
    """
    place = folder / f"round-{number}"
    made_by = {reef.name: _made_by(reef, policy, network, plan, number) for reef in reefs}
    found = {reef.name: read_rollout(place / f"{reef.name}.npz", reef, made_by[reef.name]) for reef in reefs}
    missing = [reef for reef in reefs if found[reef.name] is None]
    trained = folder / f"round-{number}.pt"
    if trained.is_file() and any((place / f"{reef.name}.npz").is_file() for reef in missing):
        raise MethodError(
            f"{trained}: holds a training on rollouts of another length (--rollout-s), or of another version; --again "
            "starts over, or choose another --out"
        )
    task = partial(
        rollout,
        checkpoint=folder / f"round-{number - 1}.pt",
        network=network,
        plan=plan,
        number=number,
        made_by=made_by,
    )
    several = workers > 1 and len(missing) > 1
    with bar(f"round-{number}: rolling out", "rollouts") as told:
        for reef, data in run_in_processes(task, missing, workers, warm_up) if several else run_here(task, missing):
            write_atomically(place / f"{reef.name}.npz", data)
            found[reef.name] = read_rollout(place / f"{reef.name}.npz", reef, made_by[reef.name])
            told(sum(one is not None for one in found.values()), len(reefs))
    return [one for one in found.values() if one is not None]


def _made_by(reef: Reef, policy: Checkpoint, network: SteeringNetworkSettings, plan: Rounds, number: int) -> str:
    """Identity of a rollout, all that determines it, as text."""
    size = (network.width, network.height)
    made = [policy.digest(), reef.split.digest(), reef.name, number, plan.mixture(number), plan.seconds, size]
    return json.dumps([*made, PROGRAM, steering_source()])


def rollout(
    reef: Reef,
    checkpoint: Path,
    network: SteeringNetworkSettings,
    plan: Rounds,
    number: int,
    made_by: Mapping[str, str],
) -> bytes:
    """Roll out the policy, and return the contents of an NPZ file: small images, senses, maps of what was looked at,
    and the expert's values of the commands."""
    from oysterbench.exploration.rollout import explore
    from oysterbench_baselines.steering.method import SteeringNet

    task = reef.split.steering
    assert task is not None
    memory = Memory(task)
    _, taught = explore(
        reef.split,
        reef.name,
        SteeringNet(str(checkpoint)),
        seconds=plan.seconds,
        start=number,
        teacher=True,
        mixture=plan.mixture(number),
    )
    data = io.BytesIO()
    np.savez(
        data,
        made_by=np.array(made_by[reef.name]),
        pixels=np.stack([small(view.pixels, network) for view, _ in taught]),
        senses=np.stack([senses_of(view.state, task) for view, _ in taught]),
        looked=np.stack([memory.observe(view.state, view.time_s) for view, _ in taught]),
        action_values=np.stack([action_values for _, action_values in taught]).astype(np.float32),
    )
    return data.getvalue()


def read_rollout(path: Path, reef: Reef, made_by: str) -> TrainingExamples | None:
    """Read the examples of a rollout's file; None where there is no such file, or it is of another rollout."""
    if not path.is_file() or reef.split.steering is None:
        return None
    with np.load(path) as held:
        if str(held["made_by"]) != made_by:
            return None
        return TrainingExamples(
            reef.split.steering,
            held["pixels"],
            held["senses"],
            held["looked"],
            held["action_values"],
            np.ones(len(held["action_values"]), dtype=bool),
        )


def warm_up() -> None:
    """Prepare a worker process for rollouts by importing what they need."""
    import oysterbench.exploration  # noqa: F401
