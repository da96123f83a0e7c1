"""The training loop: deterministic, resumable at any step, on a GPU where one is available."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch
from torch.utils.data import DataLoader, Dataset

from oysterbench.cli.interrupts import started_over
from oysterbench.core.errors import MethodError
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint, versions

KEEP_S = 30.0
"""Time between two checkpoints, seconds: the most that a kill costs."""

Progress = Callable[[int, int], None]
"""Called with the number of steps done and the total."""
Network = TypeVar("Network", bound=torch.nn.Module)
Loss = Callable[..., torch.Tensor]
"""Called with the network and the tensors of a batch; returns the value to minimise."""


class Trainer(Protocol):
    """The object of a training: networks, their optimisers, and how they take one step."""

    def step(self, number: int) -> list[float]:
        """Take a step and return its losses. Raises MethodError where one is no longer finite."""
        ...

    def state(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        """States of the networks, on the CPU, of their optimisers, and of torch's generators, as stored in a
        checkpoint."""
        ...

    def load(self, checkpoint: Checkpoint) -> None:
        """Restore the state from a checkpoint."""
        ...


@dataclass(frozen=True)
class FitSettings:
    """Optimiser settings: AdamW (Loshchilov & Hutter 2019) with a linear warm-up and a cosine decay to zero.

    start: share of the initial weights in the final ones. Their average holds up better than the last weights on data
    unlike that of the training (Wortsman et al. 2022, "Robust fine-tuning of zero-shot models")
    threads: of the CPU; with a GPU, the number of processes that prepare batches, if more than one
    """

    steps: int = 1000
    learning_rate: float = 5e-3
    weight_decay: float = 1e-2
    warm_up: int = 50
    threads: int = 2
    start: float = 0.0

    def rate(self, step: int) -> float:
        """Learning rate of a step: a function of its number alone, so that a resumed training uses the same."""
        if step < self.warm_up:
            return self.learning_rate * (step + 1) / self.warm_up
        share = (step - self.warm_up) / max(1, self.steps - self.warm_up)
        return self.learning_rate * 0.5 * (1 + math.cos(math.pi * share))


def pick_device(name: str) -> torch.device:
    """Return the torch device of that name; `auto`: a GPU if one is available. Raises MethodError where the name is
    invalid or no GPU is available."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        device = None
    if device is None or device.type not in ("cpu", "cuda"):
        raise MethodError(f"device {name!r}: expected auto, cpu, cuda or cuda:N")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise MethodError(f"device {name!r}: this PyTorch sees no GPU; expected auto or cpu")
    return device


def be_deterministic(threads: int, device: torch.device) -> None:
    """Fix the order of summation: a fixed number of threads, and kernels with a deterministic order. On a GPU weights
    are not reproducible: some CUDA kernels have no deterministic form, and others are many times slower in it."""
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(device.type == "cpu")
    torch.backends.cudnn.benchmark = device.type == "cuda"


def run_training(
    make: Callable[[], Trainer],
    network: Mapping[str, Any],
    identity: Mapping[str, Any],
    steps: int,
    path: Path,
    progress: Progress = lambda done, total: None,
    keep: Callable[[Checkpoint], None] = lambda checkpoint: None,
    keep_s: float | None = None,
    again: bool = False,
) -> Checkpoint:
    """Train, or resume from the checkpoint at `path`, and return the finished checkpoint, which is also at `path`.

    network: its description in the checkpoint; keep: called after each checkpoint is written, every `keep_s` seconds.
    again: start over; what is at `path` stays there until the new training is finished, whose checkpoints are beside it
    (`beside`) until then: if it was interrupted, a call without `again` resumes it. Raises MethodError where `path`
    holds a training of another identity.
    """
    anew = beside(path)
    known = read_checkpoint(anew) if anew.is_file() and not again else None
    again = again or (known is not None and known.identity == dict(identity))
    if not again:
        known = read_checkpoint(path) if path.is_file() else None
    if known is not None and known.identity != dict(identity):
        raise MethodError(
            f"{path}: {_difference(known.identity, identity)}; remove it to train anew, or choose another --out"
        )
    if known is not None and known.finished:
        return known
    trainer = make()
    state = known or Checkpoint(dict(identity), dict(network), {}, {}, {}, 0, False, [], 0.0, versions())
    if known is not None:
        trainer.load(known)
    elif again:
        state.weights, state.optimiser, state.random = trainer.state()
        state.write(anew)
    if again:
        started_over()
    kept, cpu, before = time.monotonic(), time.process_time(), state.seconds
    while not state.finished:
        if state.step < steps:
            state.losses += trainer.step(state.step)
            state.step += 1
            progress(state.step, steps)
        state.finished = state.step >= steps
        if state.finished or time.monotonic() - kept >= (KEEP_S if keep_s is None else keep_s):
            state.weights, state.optimiser, state.random = trainer.state()
            if state.finished:  # what only resuming needs is two thirds of a file
                state.optimiser, state.random = {}, {}
            state.seconds = before + time.process_time() - cpu
            state.write(anew if again and not state.finished else path)
            keep(state)
            kept = time.monotonic()
    if again:
        anew.unlink(missing_ok=True)
    return state


def beside(path: Path) -> Path:
    """Path of the checkpoints of a training that starts over, which replaces what is at `path` once it is finished."""
    return path.with_name(f"{path.name}.again")


@dataclass
class Fitting:
    """Trainer of one network by AdamW. batch: returns the batch of a step from its number."""

    model: torch.nn.Module
    batch: Callable[[int], tuple[torch.Tensor, ...]]
    loss: Loss
    settings: FitSettings
    device: torch.device

    def __post_init__(self) -> None:
        rate, decay = self.settings.learning_rate, self.settings.weight_decay
        self.optimiser = torch.optim.AdamW(self.model.parameters(), lr=rate, weight_decay=decay)
        self.started = [one.detach().clone() for one in self.model.parameters()] if self.settings.start else []
        self.model.train()
        self._prepared: Iterator[tuple[torch.Tensor, ...]] | None = None

    def _batch(self, number: int) -> tuple[torch.Tensor, ...]:
        """Batch of a step. A GPU would wait for a single core to prepare it, so other processes do so in advance."""
        if self.device.type == "cpu" or self.settings.threads == 1:
            return self.batch(number)
        if self._prepared is None:
            self._prepared = prepared(self.batch, range(number, self.settings.steps), self.settings.threads)
        return next(self._prepared)

    def step(self, number: int) -> list[float]:
        tensors = [part.to(self.device) for part in self._batch(number)]
        for group in self.optimiser.param_groups:
            group["lr"] = self.settings.rate(number)
        self.optimiser.zero_grad(set_to_none=True)
        found = self.loss(self.model, *tensors)
        value = float(found.detach())
        if not math.isfinite(value):
            raise MethodError(f"the loss is {value} after {number} steps; a lower learning rate may help")
        found.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        self.optimiser.step()
        if self.started and number + 1 == self.settings.steps:
            torch._foreach_lerp_([one.detach() for one in self.model.parameters()], self.started, self.settings.start)
        return [value]

    def state(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        return weights_of(self.model), self.optimiser.state_dict(), _random()

    def load(self, checkpoint: Checkpoint) -> None:
        self.model.load_state_dict(checkpoint.weights)
        self.optimiser.load_state_dict(checkpoint.optimiser)
        _set_random(checkpoint.random)


@dataclass(frozen=True)
class _Batches(Dataset[tuple[torch.Tensor, ...]]):
    batch: Callable[[int], tuple[torch.Tensor, ...]]

    def __getitem__(self, number: int) -> tuple[torch.Tensor, ...]:
        return self.batch(number)


def prepared(
    batch: Callable[[int], tuple[torch.Tensor, ...]], steps: range, workers: int
) -> Iterator[tuple[torch.Tensor, ...]]:
    """Batches of the given steps, in order, prepared in advance by worker processes: at most one per core."""
    loader = DataLoader(
        _Batches(batch),
        batch_size=None,
        sampler=steps,
        num_workers=min(workers, os.cpu_count() or 1),
        prefetch_factor=4,
        multiprocessing_context="fork",  # workers share the data already read, and `batch` may be a closure
    )
    return iter(loader)


def fit(
    make: Callable[[], torch.nn.Module],
    network: Mapping[str, Any],
    batch: Callable[[int], tuple[torch.Tensor, ...]],
    loss: Loss,
    settings: FitSettings,
    identity: Mapping[str, Any],
    path: Path,
    device: torch.device,
    first_seed: int,
    progress: Progress = lambda done, total: None,
    again: bool = False,
) -> Checkpoint:
    """Train a network by AdamW, or resume from the checkpoint at `path`; with `again`, start over (`run_training`).

    make: creates the network, its weights drawn from torch's generator; batch: returns the tensors of a step; loss: of
    the network on them.
    """
    be_deterministic(settings.threads, device)

    def begin() -> Trainer:
        torch.manual_seed(first_seed)
        model = make().to(device)
        if device.type == "cuda":  # a step takes 40 ms on an H200 in this layout, 46 ms in the one CPUs prefer
            model.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
        return Fitting(model, batch, loss, settings, device)

    return run_training(begin, network, identity, settings.steps, path, progress, again=again)


def channels_last(network: Network) -> Network:
    """Return the same network with its weights in the memory layout that CPUs prefer."""
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network


def weights_of(model: torch.nn.Module) -> dict[str, torch.Tensor]:
    """Weights of a network, on the CPU."""
    return {key: value.detach().cpu() for key, value in model.state_dict().items()}


def _random() -> dict[str, Any]:
    found: dict[str, Any] = {"cpu": torch.get_rng_state()}
    if torch.cuda.is_available():
        found["cuda"] = torch.cuda.get_rng_state_all()
    return found


def _set_random(state: Mapping[str, Any]) -> None:
    torch.set_rng_state(state["cpu"])
    if "cuda" in state and torch.cuda.is_available() and len(state["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all(state["cuda"])


def _difference(known: Mapping[str, Any], wanted: Mapping[str, Any], of: str = "") -> str:
    """Describe the first difference between two identities in words. of: key of what is compared"""
    for key in dict.fromkeys([*known, *wanted]):
        mine, other = known.get(key), wanted.get(key)
        if mine != other:
            if isinstance(mine, Mapping) and isinstance(other, Mapping):
                return _difference(mine, other, key)
            if key == "held_out":
                return "holds a training that held out other images to measure its thresholds, or does not say which"
            why = f": the images or labels of {key} have changed" if of == "data" and mine and other else ""
            return f"holds a training with {key} = {str(mine)[:60]}, and this one has {key} = {str(other)[:60]}{why}"
    return "holds another training"
