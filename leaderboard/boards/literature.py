"""Results reported by others on other data: in a separate table, never ranked with ours."""

from __future__ import annotations

import tomllib
from importlib import resources

from oysterbench.core.errors import ResultError
from oysterbench.results.standings import PRIMARY
from oysterbench_leaderboard.boards.board import Literature

REPORTED = "Reported by others, on other data: not comparable with the boards, nor with each other across data sets."

_SHARED = {"track", "metric", "data", "source", "url", "note"}
_OWN = {"method", "value", "note", "source", "url"}


def literature(track: str | None = None) -> list[Literature]:
    """All rows of `literature.toml`, or those of a track, in the order of the file."""
    text = (resources.files("oysterbench_leaderboard") / "literature.toml").read_text(encoding="utf-8")
    return [row for row in parse_literature(text) if track is None or row.track == track]


def parse_literature(text: str) -> list[Literature]:
    """Parse the rows of such a file: [[group]] has what its rows share, `row` has method, value and other own keys.
    Raises ResultError naming the group."""
    try:
        groups = tomllib.loads(text)["group"]
    except (tomllib.TOMLDecodeError, KeyError) as error:
        raise ResultError(f"literature.toml: expected TOML with [[group]]: {error}") from None
    found = []
    for k, group in enumerate(groups, start=1):
        shared = {key: value for key, value in group.items() if key != "row"}
        for row in group.get("row", []):
            values = {**shared, **row}
            if odd := (shared.keys() - _SHARED) | (row.keys() - _OWN):
                raise ResultError(f"literature.toml: group {k}: unknown keys {', '.join(sorted(odd))}")
            if missing := [
                key for key in ("track", "method", "metric", "value", "data", "source") if key not in values
            ]:
                raise ResultError(f"literature.toml: group {k}: missing keys {', '.join(missing)}")
            if values["track"] not in PRIMARY:
                raise ResultError(f"literature.toml: group {k}: expected a track of {', '.join(PRIMARY)}")
            notes = [text for text in (row.get("note"), shared.get("note")) if text]
            found.append(Literature(**{**values, "note": "; ".join(notes)}))
    return found
