"""The command `doctor`: the state of this machine. `cli.main` adds it."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.errors import MachineError

COLOURS = {"ok": "green", "poor": "yellow", "missing": "dim", "broken": "bold red"}


@click.command(short_help="Check what is installed, missing or broken, and what to type.")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def doctor(as_json: bool) -> None:
    """Check this machine: what is installed and what is missing, GPU, memory, disk, the home folder and its contents,
    the hub and its key, published systems, and the sandbox for methods.

    \b
    Examples:
      oysterbench doctor
      oysterbench doctor --json

    ok: present; missing: optional, with what to type to get it; poor: works, but not well; broken: set or installed,
    but does not work. Exits with 1 if anything is broken. Uses no network and changes nothing.
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
            message(f"nothing is broken; {len(missing)} optional things are missing")
    if broken:
        raise MachineError(f"broken: {'; '.join(f'{one.name}: {one.detail}' for one in broken)}")
