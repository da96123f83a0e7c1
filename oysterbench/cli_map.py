"""The command that makes a cloud of a sequence along a trajectory: parse, call, print. `cli` takes it in."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import click

SOURCES = ("pictures", "echoes")


@click.command("map", short_help="A coloured point cloud (PLY) of a sequence along any trajectory.")
@click.argument("sequence", type=click.Path(path_type=Path))
@click.argument("trajectory", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="The cloud: a .ply file.")
@click.option(
    "--from", "source", type=click.Choice(SOURCES), default="pictures", show_default=True, help="What it is made of."
)
@click.option("--camera", "cameras", multiple=True, metavar="NAME", help="Look through this one.  [default: the first]")
@click.option("--voxel", "voxel_m", type=float, help="One point per cube of so many metres.  [default: 0.01]")
@click.option("--far", "far_m", type=float, help="Farthest that is searched for, in m.  [default: 6]")
@click.option("--json", "as_json", is_flag=True, help="Print what was made as JSON.")
def map_command(
    sequence: Path,
    trajectory: Path,
    out: Path,
    source: str,
    cameras: tuple[str, ...],
    voxel_m: float | None,
    far_m: float | None,
    as_json: bool,
) -> None:
    """Make a coloured point cloud of what a sequence shows, in the world frame of a trajectory.

    \b
    Examples:
      oysterbench map mini-01.mcap results/mini-01-gtsam_vi.tum --out mini-01.ply
      oysterbench map dive.mcap poses.tum --from echoes --voxel 0.05 --out bottom.ply

    Pictures give the depths between two cameras that see the same, or, of one camera, between its frames on the way.
    Echoes are those of DVL, altimeters and imaging sonars, coloured from the pictures; a fan of a sonar tells no
    elevation, so that its first echo is put on its lower edge. Truth is not used: `export --format ply` does that.
    """
    from oysterbench.errors import OysterbenchError
    from oysterbench.mapping import CloudSettings, build_cloud
    from oysterbench.sequence import open_sequence
    from oysterbench.trajectory import read_trajectory

    if out.suffix.lower() != ".ply":
        raise OysterbenchError(f"{out}: expected the name of a .ply file")
    settings = CloudSettings()
    if voxel_m is not None:
        settings = replace(settings, voxel_m=voxel_m)
    if far_m is not None:
        settings = replace(settings, far_m=far_m)
    opened = open_sequence(sequence)
    start = time.process_time()
    cloud = build_cloud(opened, read_trajectory(trajectory), source, cameras, settings)
    if len(cloud) == 0:
        raise OysterbenchError(
            f"{opened.name}: no point was found from {source} along {trajectory}; nothing is written"
        )
    cloud.write(out, f"{opened.name} along {trajectory.name}, from {source}, in odom, m")
    facts = {
        "file": str(out),
        "points": len(cloud),
        "source": source,
        "low_m": cloud.points.min(axis=0).round(3).tolist(),
        "high_m": cloud.points.max(axis=0).round(3).tolist(),
        "cpu_s": round(time.process_time() - start, 1),
    }
    if as_json:
        click.echo(json.dumps(facts, indent=2))
        return
    sides = " x ".join(f"{high - low:.1f}" for low, high in zip(facts["low_m"], facts["high_m"], strict=True))
    click.echo(f"{out}: {len(cloud)} points from {source}, {sides} m")
