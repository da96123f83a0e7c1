"""Whether another installation, Python or processor renders the same bytes: `python -m tests.benchmarks.bytes` with
`--out here.json` in the one, with `--against here.json` in the other.

Of each split some parts, frames and pings spread over a sequence and its small sensors, are hashed: seconds each, where
the split takes hours. `--target x86-64-v4` compiles the kernels for another processor; the paths of NumPy, OpenCV and
OpenBLAS are chosen by their variables (NPY_DISABLE_CPU_FEATURES, OPENCV_CPU_DISABLE, OPENBLAS_CORETYPE).
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

from oysterbench.core.ros import Message
from oysterbench.hub.release import made_with

SPLITS = ("slam-mini", "seg-mini", "steer-mini")


def main() -> None:
    """Print a line for each part, or those that differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("splits", nargs="*", default=SPLITS, help="NAME or NAME/SEQUENCE")
    parser.add_argument("--frames", type=int, default=4, help="of each camera or sonar of a sequence")
    parser.add_argument("--target", help="processor that kernels are compiled for, as clang names it")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--against", type=Path)
    options = parser.parse_args()
    if options.target:
        from oysterbench.render import target

        flags = target.COMPILER_FLAGS.partition(" -target-cpu")[0]
        target.KERNEL_OPTIONS["cpu_compiler_flags"] = f"{flags} -target-cpu {options.target}"

    found: dict[str, str] = {}
    for named in options.splits:
        split, _, sequence = named.partition("/")
        found |= hashes(split, sequence, options.frames)
    if options.out:
        options.out.write_text(json.dumps({"made_with": made_with(), "parts": found}, indent=1))
    if options.against:
        compare(json.loads(options.against.read_text()), found)


def hashes(split_name: str, sequence_name: str, frames: int) -> dict[str, str]:
    """Part and topic -> SHA-256 of its messages, of a sequence or the first one of the split."""
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import PROGRAM, make_part
    from oysterbench.simulation.jobs import plan

    split = load_split(split_name)
    sequence = split.find_sequence(sequence_name) if sequence_name else split.sequence[0]
    jobs = plan(split, sequence)
    chosen = [job for job in jobs if not job.source]
    for source in sorted({job.source for job in jobs if job.source}):
        own = [job for job in jobs if job.source == source]
        chosen += own[:: max(1, len(own) // frames)][:frames]
    found: dict[str, str] = {}
    for job in chosen:
        name = f"{split.name}/{job.sequence}/{job.part}"
        for what, digest in of_part(make_part(split, job, b"", "cpu", PROGRAM)).items():
            found[f"{name} {what}"] = digest
        print(name, flush=True)
    return found


def of_part(part: bytes) -> dict[str, str]:
    """Topic or table -> SHA-256 of what a part says of it."""
    import tempfile

    from oysterbench.sequence.file import Reading, read_attachments, read_messages

    with tempfile.NamedTemporaryFile(suffix=".mcap") as file:
        file.write(part)
        file.flush()
        path = Path(file.name)
        with Reading(path) as (_, summary):
            topics = sorted(channel.topic for channel in summary.channels.values())
        found = {topic: _digest([*read_messages(path, [topic])]) for topic in topics}
        return found | {name: hashlib.sha256(data).hexdigest() for name, data in read_attachments(path).items()}


def _digest(messages: list[Message]) -> str:
    whole = hashlib.sha256()
    for message in messages:
        whole.update(f"{message.stamp_ns} {len(message.data)} ".encode() + bytes(message.data))
    return whole.hexdigest()


def compare(other: dict[str, dict[str, str]], found: dict[str, str]) -> None:
    """Print what differs."""
    here, there = made_with(), other["made_with"]
    for what in sorted({*here, *there}):
        if here.get(what) != there.get(what):
            print(f"{what}: {there.get(what)} there, {here.get(what)} here")
    both = [part for part in found if part in other["parts"]]
    differing = [part for part in both if found[part] != other["parts"][part]]
    for part in differing:
        print(f"differs: {part}")
    print(f"{len(both) - len(differing)} of {len(both)} are the same")


if __name__ == "__main__":
    main()
