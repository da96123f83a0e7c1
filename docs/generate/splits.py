"""The page of all splits with size and rendering cost, from the recipes and the estimate of `oysterbench splits`."""

from __future__ import annotations

from dataclasses import dataclass

from docs.generate.markdown import code, table

HEAD = """# Splits in numbers

Every included split, from its recipe: images of all its cameras, minutes of all its sequences, and the CPU time of
rendering, as estimated by `oysterbench splits SPLIT`. What each is for and what it contains:
[the splits](../../datasets/README.md).

"""


@dataclass(frozen=True)
class SplitFacts:
    """Size of a split according to its recipe; cpu_h: estimated CPU time of rendering it, h."""

    name: str
    version: str
    track: str
    summary: str
    sequences: int
    images: int
    minutes: float
    cpu_h: float
    hidden: bool


def split_facts() -> list[SplitFacts]:
    """Facts of all included splits, in order of name."""
    from oysterbench.recipe import count, load_split, split_names
    from oysterbench.simulation import cost

    found = []
    for split in map(load_split, split_names()):
        images = sum(
            count(sequence.duration_s, camera.rate_hz)
            for sequence in split.sequence
            for camera in split.rig_of(sequence).camera
        )
        found.append(
            SplitFacts(
                name=split.name,
                version=split.version,
                track=split.track,
                summary=split.summary,
                sequences=len(split.sequence),
                images=images,
                minutes=sum(sequence.duration_s for sequence in split.sequence) / 60,
                cpu_h=sum(cost.estimated(split, sequence) for sequence in split.sequence) / 3600,
                hidden=split.hidden,
            )
        )
    return found


def splits_page() -> str:
    """The page of all splits."""
    rows = [
        (
            code(facts.name),
            facts.track,
            str(facts.sequences),
            str(facts.images),
            f"{facts.minutes:.3g}",
            f"{facts.cpu_h:.2g}",
            facts.summary + (" (hidden)" if facts.hidden else ""),
        )
        for facts in split_facts()
    ]
    return HEAD + table(("Split", "Track", "Sequences", "Images", "Minutes", "CPU-hours", "What"), rows)
