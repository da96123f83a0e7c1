"""The training loop: deterministic, resumable at any step, on a GPU where there is one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from oysterbench.core.errors import MethodError
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint, versions

KEEP_S = 30.0
"""Between two checkpoints: what a kill costs at most."""

Progress = Callable[[int, int, float], None]
"""Called with the steps done, the steps wanted, and the loss."""
Loss = Callable[..., torch.Tensor]
"""Called with the network and the tensors of a batch; what is to become small."""


@dataclass(frozen=True)
class FitSettings:
    """How the weights are found: AdamW (Loshchilov & Hutter 2019), a linear warm-up and a cosine to zero."""

    steps: int = 1000
    learning_rate: float = 5e-3
    weight_decay: float = 1e-2
    warm_up: int = 50
    threads: int = 2

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
    """Sums in one order: the same number of threads each time, and kernels that have only one."""
    torch.set_num_threads(threads)
    # Some of CUDA's have no such kernel: there a warning is all there can be, and weights repeat on the CPU alone.
    torch.use_deterministic_algorithms(True, warn_only=device.type == "cuda")
    torch.backends.cudnn.benchmark = False


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
    progress: Progress = lambda done, total, loss: None,
) -> Checkpoint:
    """Train, or go on where `path` was left; the finished checkpoint, which is at `path` as well.

    make: the network, its weights drawn from torch's generator; network: what a checkpoint says of it; batch: the
    tensors of a step; loss: of the network on them. Raises MethodError where `path` holds a training of another
    identity, or where the loss is not finite any more.
    """
    be_deterministic(settings.threads, device)
    known = read_checkpoint(path) if path.is_file() else None
    if known is not None and known.identity != dict(identity):
        raise MethodError(f"{path}: {_difference(known.identity, identity)}; --again trains anew, --out goes elsewhere")
    if known is not None and known.finished:
        return known
    torch.manual_seed(first_seed)
    model = make().to(device)
    optimiser = torch.optim.AdamW(model.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
    state = known or Checkpoint(dict(identity), dict(network), {}, {}, {}, 0, False, [], 0.0, versions())
    if known is not None:
        model.load_state_dict(known.weights)
        optimiser.load_state_dict(known.optimiser)
        _set_random(known.random)
    model.train()
    kept, cpu, before = time.monotonic(), time.process_time(), state.seconds

    def keep(finished: bool) -> None:
        state.weights = {key: value.detach().cpu() for key, value in model.state_dict().items()}
        state.optimiser, state.random, state.finished = optimiser.state_dict(), _random(), finished
        state.seconds = before + time.process_time() - cpu
        state.write(path)

    for step in range(state.step, settings.steps):
        tensors = [part.to(device) for part in batch(step)]
        for group in optimiser.param_groups:
            group["lr"] = settings.rate(step)
        optimiser.zero_grad(set_to_none=True)
        found = loss(model, *tensors)
        value = float(found.detach())
        if not math.isfinite(value):
            raise MethodError(f"the loss is {value} after {step} steps; a lower learning rate may help")
        found.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        state.losses.append(value)
        state.step = step + 1
        progress(state.step, settings.steps, value)
        if time.monotonic() - kept >= KEEP_S and state.step < settings.steps:
            keep(finished=False)
            kept = time.monotonic()
    keep(finished=True)
    return state


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
