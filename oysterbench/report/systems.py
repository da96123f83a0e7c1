"""Published systems and their state here."""

from __future__ import annotations

from collections.abc import Iterable

from oysterbench.methods.systems import System
from oysterbench.methods.systems.building import Build
from oysterbench.report.table import Column, Table, TableRow

COLUMNS = (
    Column("system", "System"),
    Column("method", "Method"),
    Column("sensors", "Sensors"),
    Column("mode", "Mode"),
    Column("licence", "Licence"),
    Column("state", "Here"),
    Column("about", "About", hidden=True),
    Column("paper", "Paper", hidden=True),
    Column("commit", "Commit", hidden=True),
)


def systems_table(known: Iterable[tuple[System, Build | None]]) -> Table:
    """A row for each method, the state of its system with the first of them."""
    rows = []
    for system, build in known:
        described = system.description
        state = "not built" if build is None else f"built, {build.commit[:8] or 'package'}"
        for name, method in described.methods.items():
            sensors = ", ".join(method.sensors)
            mode = "online" if method.online else "offline"
            values = (described.title, name, sensors, mode, described.licence, state, method.about, described.paper)
            rows.append(TableRow((*values, described.commit)))
    note = "Build one: oysterbench systems build SYSTEM. Run it: oysterbench run METHOD --split slam-mini."
    return Table("Published systems", COLUMNS, tuple(rows), (note,))
