"""The command `systems`: which published systems there are, and whether they are built here."""

from __future__ import annotations

import json
from pathlib import Path

import click

from oysterbench.cli.echo import echo, message


@click.group("systems", invoke_without_command=True, short_help="List published systems, and build them here.")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
@click.pass_context
def systems_command(context: click.Context, as_json: bool) -> None:
    """List published systems with the methods each provides, and their state on this machine.

    \b
    Examples:
      oysterbench systems
      oysterbench systems build openvins
      oysterbench systems build openvins --source ~/open_vins
      oysterbench systems container openvins > Containerfile
      oysterbench run openvins --split slam-mini
    """
    if context.invoked_subcommand is not None:
        return
    from oysterbench.cli.outputs import print_table
    from oysterbench.methods.systems import systems
    from oysterbench.methods.systems.building import built
    from oysterbench.report.renderers.json import json_rows
    from oysterbench.report.systems import systems_table

    known = [(system, built(system)) for system in systems().values()]
    table = systems_table(known)
    if as_json:
        echo(json.dumps(json_rows(table), indent=2))
    else:
        print_table(table)


@systems_command.command("build", short_help="Get a system's source at its pinned commit, and build it.")
@click.argument("names", metavar="SYSTEM...", nargs=-1, required=True)
@click.option(
    "--source",
    "sources",
    multiple=True,
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Clone of its repository, or of a submodule's, to use instead of the network; repeatable.",
)
@click.option("--jobs", type=click.IntRange(min=1), help="Parallel compile jobs.  [default: one per core]")
@click.option("--again", is_flag=True, help="Rebuild systems that are already built.")
def build_command(names: tuple[str, ...], sources: tuple[Path, ...], jobs: int | None, again: bool) -> None:
    """Build published systems from their own sources, which are not part of this project and keep their own licences.

    \b
    Examples:
      oysterbench systems build openvins
      oysterbench systems build openvins --source ~/open_vins --jobs 1
      oysterbench systems build okvis2 --source ~/okvis2 \\
        --source ~/brisk --source ~/DBoW2 --source ~/opengv

    With --source, each repository is taken from the first clone that has its commit; the network is not used.
    """
    from oysterbench.methods.systems import find_system
    from oysterbench.methods.systems.building import build

    for system in [find_system(name) for name in names]:
        described = system.description
        message(
            f"{described.title} ({described.licence}): some {described.cpu_minutes:g} min of processor time, "
            f"{described.disk_mb:g} MB"
        )
        found = build(system, sources, jobs, again, message)
        message(
            f"built: {system.place} ({found.cpu_s / 60:.1f} min of processor time, {found.size_bytes / 1e6:.0f} MB)"
        )


@systems_command.command("container", short_help="Print a container recipe for a system.")
@click.argument("name", metavar="SYSTEM")
def container_command(name: str) -> None:
    """Print a Containerfile that builds the system and runs it with `oysterbench`; for podman, Docker and the like.

    \b
    Examples:
      oysterbench systems container openvins > Containerfile
      podman build -t oysterbench-openvins .
      podman run -v ~/.local/share/oysterbench/splits:/data/splits \\
        oysterbench-openvins run openvins --split slam-mini
    """
    from oysterbench.methods.systems import find_system
    from oysterbench.methods.systems.container import containerfile

    echo(containerfile(find_system(name)), nl=False)
