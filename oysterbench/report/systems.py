"""Published systems and their state here."""

from __future__ import annotations

from collections.abc import Iterable

from oysterbench.methods.systems import System
from oysterbench.methods.systems.building import Build
from oysterbench.report.table import Column, Table, TableRow

COLUMNS = (
    Column("system", "System"),
    Column("method", "Method"),
    Column("track", "Track", wide=True),
    Column("sensors", "Sensors", wide=True),
    Column("mode", "Mode", wide=True),
    Column("licence", "Licence", wide=True),
    Column("state", "Here"),
    Column("about", "About", hidden=True),
    Column("paper", "Paper", hidden=True),
    Column("commit", "Commit", hidden=True),
)


def systems_table(known: Iterable[tuple[System, Build | None]]) -> Table:
    """Table with a row for each method and the state of its system."""
    rows = []
    for system, build in known:
        described = system.description
        state = "not built" if build is None else f"built, {build.commit[:8] or 'package'}"
        for name, method in described.methods.items():
            # A method that takes images has no further sensors, and is neither online nor offline.
            sensors, mode = ", ".join(method.sensors) or "images", "online" if method.online else "offline"
            if method.online is None:
                mode = ""
            values = (described.title, name, method.track, sensors, mode, described.licence, state)
            rows.append(TableRow((*values, method.about, described.paper, described.commit)))
    note = "Build one: oysterbench systems build SYSTEM. Run it: oysterbench run METHOD --split slam-mini, or seg-mini."
    return Table("Published systems", COLUMNS, tuple(rows), (note,))
