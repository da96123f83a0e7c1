"""Methods run on sequences as a track does it, without a command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from oysterbench.methods.adapters import MethodAdapter, PythonMethod
from oysterbench.methods.interfaces import RunSequence
from oysterbench.tracks import Request, Track
from oysterbench.tracks.track import Finished


def finished_of(
    track: Track,
    sequences: Sequence[RunSequence],
    methods: Sequence[str | MethodAdapter],
    settings: Any,
    out: Path,
    **options: Any,
) -> list[Finished]:
    """What was finished, in that order; one job at a time."""
    adapters = [PythonMethod(one, track.takes) if isinstance(one, str) else one for one in methods]
    request = Request(out, **{"jobs": 1, **options})
    return list(track.run(sequences, adapters, settings, request))


def runs_of(*args: Any, **options: Any) -> list[Any]:
    """What was scored."""
    return [each.scored for each in finished_of(*args, **options)]
