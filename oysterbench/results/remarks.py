"""Remarks that a reader needs before the numbers of comparisons."""

from __future__ import annotations

import json
from collections.abc import Sequence

from oysterbench.results.comparison import Board
from oysterbench.results.labels import few
from oysterbench.results.machines import machines_note
from oysterbench.results.records import plain


def remarks(found: Sequence[Board]) -> list[str]:
    """Say in words which boards are kept apart and why, which sequences are left out, and why intervals or places are
    missing."""
    notes = []
    if len(found) > 1:
        notes.append(f"shown as {len(found)} separate comparisons, since they differ in {_differences(found)}")
    for board in found:
        where = f"{board.name}: " if len(found) > 1 else ""
        if board.left_out:
            names = ", ".join(board.left_out)
            notes.append(
                f"{where}standings are over the {_sequences(len(board.sequences))} that every method was run on, "
                f"without {names}"
            )
        notes += [f"{where}{note}" for note in (machines_note(board.records),) if note]
        reasons = dict.fromkeys(
            row.summaries[board.metric].interval.reason for row in board.standings if board.metric in row.summaries
        )
        notes += [f"{where}{reason}" for reason in reasons if reason and not reason.startswith("no run")]
        notes += [
            f"{where}{row.label} has no {board.metric} and no place"
            for row in board.standings
            if row.standing.place is None and board.sequences
        ]
    return notes


def _sequences(count: int) -> str:
    return "one sequence" if count == 1 else f"{count} sequences"


def _differences(found: Sequence[Board]) -> str:
    parts = []
    for key, noun in (("track", "track"), ("split", "split"), ("evaluator_version", "evaluator")):
        values = list(dict.fromkeys(getattr(board, key) or "no split" for board in found))
        if len(values) > 1:
            parts.append(f"{noun} ({few(values)})")
    if any(a.split == b.split and a.split_digest != b.split_digest for a in found for b in found):
        parts.append("recipe of the split")
    by_data: dict[tuple[str, str], list[Board]] = {}  # settings of different tracks differ anyway, which says nothing
    for board in found:
        by_data.setdefault((board.track, board.split), []).append(board)
    differing: dict[str, dict[str, None]] = {}
    for group in by_data.values():
        for key in dict.fromkeys(key for board in group for key in board.settings):
            written = dict.fromkeys(json.dumps(plain(board.settings.get(key))) for board in group)
            if len(written) > 1:
                differing.setdefault(key, {}).update(written)
    parts += [f"setting {key} ({few(list(written))})" for key, written in differing.items()]
    return ", ".join(parts)
