"""Running a method in this process, for notebooks, tests and debuggers; `runner` isolates and measures it better."""

from __future__ import annotations

import time
from dataclasses import dataclass

from oysterbench.core.errors import MethodError, OysterbenchError
from oysterbench.methods.method import Estimate, Method
from oysterbench.sequence.types import Sequence


@dataclass(frozen=True)
class Run:
    """One run of a method on a sequence, with its wall and CPU time."""

    estimate: Estimate
    wall_s: float
    cpu_s: float


def run_method(method: Method, sequence: Sequence) -> Run:
    """Run a method on the sensors of a sequence. Any exception of the method becomes a MethodError."""
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        estimate = method.run(sequence.for_method())
    except OysterbenchError:
        raise
    except Exception as error:
        raise MethodError(
            f"method {method.name!r} failed on sequence {sequence.name}: {type(error).__name__}: {error}"
        ) from error
    return Run(estimate, time.perf_counter() - wall, time.process_time() - cpu)
