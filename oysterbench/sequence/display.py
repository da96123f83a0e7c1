"""How a sequence looks in a notebook."""

from __future__ import annotations

from collections.abc import Iterator

from oysterbench.core.display import CardPicture, CardTable, card, picture
from oysterbench.core.errors import OysterbenchError
from oysterbench.sequence.truth import TRUTH
from oysterbench.sequence.types import Sequence

CAMERAS_SHOWN = 4


def outline(sequence: Sequence) -> str:
    """What a sequence holds, in a line."""
    cameras = [f"{name} {c.width} x {c.height} at {c.rate_hz:g} Hz" for name, c in sequence.cameras.items()]
    others = [name for name in sequence.sensors() if name not in sequence.cameras]
    truth = "truth" if has_truth(sequence) else "no truth"
    return "; ".join([f"{sequence.duration_s:g} s", *cameras, *([", ".join(others)] if others else []), truth])


def has_truth(sequence: Sequence) -> bool:
    """Whether it says where the vehicle truly was, as far as its list of contents tells."""
    return TRUTH in (topic for topic, _, _ in sequence.contents())


def sequence_card(sequence: Sequence) -> str:
    """Facts, a frame of each camera, and a row for each topic."""
    rows = [
        (topic, kind, count, f"{count / max(sequence.duration_s, 1e-9):.1f}")
        for topic, kind, count in sequence.contents()
    ]
    tables = [CardTable(("topic", "type", "messages", "per second"), rows)]
    return card(sequence.name, outline(sequence), tables, _frames(sequence))


def _frames(sequence: Sequence) -> Iterator[CardPicture]:
    for name in list(sequence.cameras)[:CAMERAS_SHOWN]:
        try:
            first = next(iter(sequence.images(name)), None)
        except OysterbenchError:  # the card of a damaged file still says what should be in it
            continue
        if first is not None:
            yield picture(first.pixels, name)
