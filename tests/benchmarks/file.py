"""What share of the time goes into the file: encoding, packing into parts, and putting the parts together.

    .venv/bin/python tests/benchmarks/file.py
    .venv/bin/python tests/benchmarks/file.py --split my-reef.toml --seconds 2 --format png

CPU seconds of one process, all in one run, so that the ratio holds on a busy machine too. Building the scene and
compiling kernels are not counted, as they would only make the share of the file smaller.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from oysterbench.recipe import load_split
from oysterbench.sensors.registry import sensor_kinds
from oysterbench.sequence.write import pack
from oysterbench.simulation import generate
from oysterbench.simulation.assembly import assemble
from oysterbench.simulation.simulated_sequence import build_sequence

SHARE = 0.10
"""At most so much of the time may go into the file."""


class Clock:
    """CPU seconds that pass inside some functions."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            start = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                self.spent[name] = self.spent.get(name, 0.0) + time.process_time() - start

        return call

    def drawn(self, name: str, items: Iterator[Any]) -> Iterator[Any]:
        """The items, with the time that making them takes."""
        while True:
            start = time.process_time()
            item = next(items, None)
            self.spent[name] = self.spent.get(name, 0.0) + time.process_time() - start
            if item is None:
                return
            yield item


def measure(split_name: str, seconds: float, image_format: str) -> dict[str, float]:
    """CPU seconds by what they went into."""
    split = load_split(split_name)
    sequence = dataclasses.replace(split.sequence[0], duration_s=seconds)
    rig = dataclasses.replace(
        split.rig,
        camera=tuple(dataclasses.replace(camera, image_format=image_format) for camera in split.rig.camera),
    )
    split = dataclasses.replace(split, sequence=(sequence,), rig=rig)
    build_sequence(split, sequence.name, b"")
    clock = Clock()
    kinds: list[Any] = [type(kind) for kind in sensor_kinds().values()]
    for kind in kinds:
        kind.encode = clock.timed("encoding", kind.encode)

    def pack_timed(messages: Any, *arguments: Any) -> bytes:
        return pack(clock.drawn("making", iter(messages)), *arguments)

    generate.pack = clock.timed("packing", pack_timed)  # type: ignore[attr-defined]
    generate.assemble = clock.timed("assembling", assemble)  # type: ignore[attr-defined]
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        (path,) = generate.generate_split(split, Path(folder)).values()
        total = time.process_time() - start
        size = path.stat().st_size
    spent = clock.spent
    return {
        "sensors and rendering": spent["making"] - spent["encoding"],
        "encoding": spent["encoding"],
        "packing": spent["packing"] - spent["making"],
        "assembling": spent["assembling"],
        "total": total,
        "megabytes": size / 1e6,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--split", default="slam-mini")
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--format", choices=("jpeg", "png"), default="jpeg")
    options = parser.parse_args()
    found = measure(options.split, options.seconds, options.format)
    for name in ("sensors and rendering", "encoding", "packing", "assembling"):
        print(f"{name:22s} {found[name]:7.2f} s {100 * found[name] / found['total']:5.1f} %")
    share = (found["encoding"] + found["packing"] + found["assembling"]) / found["total"]
    print(f"{'into the file':22s} {100 * share:15.1f} % of {100 * SHARE:.0f} % at most; {found['megabytes']:.1f} MB")
    raise SystemExit(share > SHARE)


if __name__ == "__main__":
    main()
