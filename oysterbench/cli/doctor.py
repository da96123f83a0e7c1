"""The command `doctor`: how this machine is. `cli` takes it in."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.errors import MachineError

COLOURS = {"ok": "green", "poor": "yellow", "missing": "dim", "broken": "bold red"}


@click.command(short_help="What is installed, missing or broken here, and what to type.")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def doctor(as_json: bool) -> None:
    """Look at this machine: what is installed and what is missing, GPU, memory, disk, the home and what is in it, the
    hub and its key, published systems, and what contains methods.

    \b
    Examples:
      oysterbench doctor
      oysterbench doctor --json

    ok: it is there; missing: it need not be, and what to type to have it; poor: it works, and not well; broken: it is
    set or installed, and does not work. Ends with 1 if anything is broken. No network is touched, and nothing changed.
    """
    from oysterbench.notebook.doctor import doctor as examine

    checkup = examine()
    broken = checkup.broken
    if as_json:
        rows = [asdict(one) for one in checkup.findings]
        echo(json.dumps({"findings": rows, "broken": len(broken)}, indent=2))
    else:
        from rich.table import Table
        from rich.text import Text

        from oysterbench.cli.outputs import print_rich
        from oysterbench.core.text import printable

        table = Table(box=None, pad_edge=False, show_header=False)
        for section, findings in checkup.sections():
            table.add_row(Text(section, style="bold"))
            for one in findings:
                detail = Text(printable(one.detail))
                if one.advice:
                    detail.append(f"; {printable(one.advice)}", style="cyan")
                table.add_row(Text(f"  {one.state}", style=COLOURS[one.state]), Text(printable(one.name)), detail)
        print_rich(table)
        missing = [one for one in checkup.findings if one.state == "missing"]
        if missing and not broken:
            message(f"nothing that is set is broken; {len(missing)} things are not here, and need not be")
    if broken:
        raise MachineError(f"broken: {'; '.join(f'{one.name}: {one.detail}' for one in broken)}")
