"""Notebook display of a sequence."""

from __future__ import annotations

from collections.abc import Iterator

from oysterbench.core.display import CardPicture, CardTable, card, picture
from oysterbench.core.errors import OysterbenchError
from oysterbench.sequence.types import Sequence

CAMERAS_SHOWN = 4


def outline(sequence: Sequence) -> str:
    """Summarise the content of a sequence in one line."""
    cameras = [f"{name} {c.width} x {c.height} at {c.rate_hz:g} Hz" for name, c in sequence.cameras.items()]
    others = [name for name in sequence.sensors() if name not in sequence.cameras]
    truth = "truth" if sequence.has_truth else "no truth"
    return "; ".join([f"{sequence.duration_s:g} s", *cameras, *([", ".join(others)] if others else []), truth])


def sequence_card(sequence: Sequence) -> str:
    """Card with facts, a frame of each camera (at most `CAMERAS_SHOWN`), and a row for each topic."""
    rates = sequence.rates()
    rows = [
        (topic, kind, count, "" if rates[topic] is None else f"{rates[topic]:.1f}")
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
