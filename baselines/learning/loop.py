"""The training loop: deterministic, resumable at any step, on a GPU where there is one."""

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

from oysterbench.core.errors import MethodError
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint, versions

KEEP_S = 30.0
"""Between two checkpoints: what a kill costs at most."""

Progress = Callable[[int, int], None]
"""Called with the steps done and the steps wanted."""
Network = TypeVar("Network", bound=torch.nn.Module)
Loss = Callable[..., torch.Tensor]
"""Called with the network and the tensors of a batch; what is to become small."""


class Trainer(Protocol):
    """What is trained: networks, their optimisers, and one step of them."""

    def step(self, number: int) -> list[float]:
        """Take a step; its losses. Raises MethodError where one is not finite any more."""
        ...

    def state(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        """Of the networks, on the processor, of their optimisers, and of torch's generators, as a checkpoint has it."""
        ...

    def load(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        ...


@dataclass(frozen=True)
class FitSettings:
    """How the weights are found: AdamW (Loshchilov & Hutter 2019), a linear warm-up and a cosine to zero.

    start: share of the weights that it began with in the final ones. The mean of both holds better on data unlike that
    of the training than the last weights do (Wortsman et al. 2022, "Robust fine-tuning of zero-shot models")
    threads: of the processor; where a GPU trains, processes that prepare batches, if more than one
    """

    steps: int = 1000
    learning_rate: float = 5e-3
    weight_decay: float = 1e-2
    warm_up: int = 50
    threads: int = 2
    start: float = 0.0

    def rate(self, step: int) -> float:
        """Learning rate of a step: a function of its number, so that a resumed training has it as well."""
        if step < self.warm_up:
            return self.learning_rate * (step + 1) / self.warm_up
        share = (step - self.warm_up) / max(1, self.steps - self.warm_up)
        return self.learning_rate * 0.5 * (1 + math.cos(math.pi * share))


def pick_device(name: str) -> torch.device:
    """`auto`: a GPU where there is one. Raises MethodError where the named one is not there."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise MethodError(f"device {name!r}: expected auto, cpu, cuda or cuda:N") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise MethodError(f"device {name!r}: this PyTorch sees no GPU; --device cpu trains on the processor")
    return device


def be_deterministic(threads: int, device: torch.device) -> None:
    """Sums in one order: the same number of threads each time, and kernels that have only one. On a GPU weights do not
    repeat: some of CUDA's kernels have no such order, and others are many times slower with it."""
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
) -> Checkpoint:
    """Train, or go on where `path` was left; the finished checkpoint, which is at `path` as well.

    network: what a checkpoint says of it; keep: called whenever a checkpoint has been written, every `keep_s` seconds.
    Raises MethodError where `path` holds a training of another identity.
    """
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
    kept, cpu, before = time.monotonic(), time.process_time(), state.seconds
    while not state.finished:
        if state.step < steps:
            state.losses += trainer.step(state.step)
            state.step += 1
            progress(state.step, steps)
        state.finished = state.step >= steps
        if state.finished or time.monotonic() - kept >= (KEEP_S if keep_s is None else keep_s):
            state.weights, state.optimiser, state.random = trainer.state()
            state.seconds = before + time.process_time() - cpu
            state.write(path)
            keep(state)
            kept = time.monotonic()
    return state


@dataclass
class Fitting:
    """One network, trained by AdamW on batches by their numbers."""

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
        """Of a step. A GPU would wait for one core that prepares them: other processes do, ahead of it."""
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
    """The batches of steps, in their order, made ahead of time by processes: one per core at most."""
    loader = DataLoader(
        _Batches(batch),
        batch_size=None,
        sampler=steps,
        num_workers=min(workers, os.cpu_count() or 1),
        prefetch_factor=4,
        multiprocessing_context="fork",  # they share what has been read, and `batch` may be a closure
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
) -> Checkpoint:
    """Train a network by AdamW, or go on where `path` was left (`run_training`).

    make: the network, its weights drawn from torch's generator; batch: the tensors of a step; loss: of the network on
    them.
    """
    be_deterministic(settings.threads, device)

    def begin() -> Trainer:
        torch.manual_seed(first_seed)
        model = make().to(device)
        if device.type == "cuda":  # a step takes 40 ms of an H200 so, and 46 ms in the layout that processors like
            model.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
        return Fitting(model, batch, loss, settings, device)

    return run_training(begin, network, identity, settings.steps, path, progress)


def channels_last(network: Network) -> Network:
    """The same, its weights laid out as processors like them."""
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network


def weights_of(model: torch.nn.Module) -> dict[str, torch.Tensor]:
    """Of a network, on the processor."""
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


def _difference(known: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """The first thing in which two identities differ, in words."""
    for key in dict.fromkeys([*known, *wanted]):
        mine, other = known.get(key), wanted.get(key)
        if mine != other:
            if isinstance(mine, Mapping) and isinstance(other, Mapping):
                return _difference(mine, other)
            return f"holds a training with {key} = {str(mine)[:60]}, and {key} = {str(other)[:60]} is asked for"
    return "holds another training"
