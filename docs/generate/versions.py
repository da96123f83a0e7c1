"""The page of the versions at this commit, from the code: library, rendering, evaluators and splits."""

from __future__ import annotations

from docs.generate.markdown import code, table


def versions_page() -> str:
    """The page of versions."""
    from oysterbench.recipe import load_split, split_names
    from oysterbench.tracks import TRACKS
    from oysterbench.version import GENERATION, VERSION

    rows = [("library", "oysterbench", VERSION), ("rendering", "generation", str(GENERATION))]
    rows += [("evaluator", name, track.evaluator) for name, track in TRACKS.items()]
    rows += [("split", split.name, split.version) for split in map(load_split, split_names())]
    listed = table(("Of", "Name", "Version"), [(kind, code(name), code(version)) for kind, name, version in rows])
    return (
        f"# Current versions\n\nWhat each version covers and when it changes: [Versions](../versions.md).\n\n{listed}"
    )
