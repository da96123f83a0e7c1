"""Export of a single oyster to a file: watertight, in metres, with vertex colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import RecipeError
from oysterbench.core.streams import Streams
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.oyster import STATES, build_oyster
from oysterbench.scene.reef import SIZE_LIMITS_M, draw_heights

SUFFIXES = (".glb", ".obj", ".stl", ".ply")
MEDIAN_M = 0.085  # median shell height, if no size is given
BROWN, GREY, PALE, INSIDE, SCAR = (
    np.array(colour)
    for colour in ((0.17, 0.14, 0.09), (0.24, 0.23, 0.20), (0.50, 0.47, 0.40), (0.64, 0.62, 0.57), (0.22, 0.15, 0.20))
)


def export_oyster(
    seed: int, path: str | Path, size_mm: float | None = None, state: str = "live"
) -> dict[str, float | int | bool]:
    """Write the oyster of a seed as GLB, OBJ, STL or PLY, according to the path's suffix; the write is atomic.

    size_mm: shell height; drawn from the seed if not given. state: one of STATES. The frame is the shell's own (origin
    at the umbo, x to the bill, z out of the right valve), in metres.

    Returns height_m, length_m and width_m of the closed shell or single valve, volume_m3 that it displaces (for a live
    oyster including its contents), triangles, watertight. Raises RecipeError for an invalid value.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     export_oyster(7, f"{folder}/oyster.stl", size_mm=100.0)["height_m"]
    0.1
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise RecipeError(f"{path}: expected a file name that ends in {', '.join(SUFFIXES)}, got {suffix or 'none'!r}")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise RecipeError(f"seed: expected a whole number from 0 to {2**63 - 1}, got {seed!r}")
    low, high = 25.0, 1000 * SIZE_LIMITS_M[1]
    if size_mm is not None and (isinstance(size_mm, bool) or not low <= size_mm <= high):
        raise RecipeError(f"size_mm: expected {low:g} to {high:g}, the range of measured oysters, got {size_mm!r}")
    if state not in STATES:
        raise RecipeError(f"state: expected one of {', '.join(STATES)}, got {state!r}")

    streams = Streams(int(seed)).at("oyster")
    height = float(draw_heights(MEDIAN_M, 1, streams.generator("size"))[0]) if size_mm is None else size_mm / 1000
    slenderness = streams.generator("slenderness").uniform()
    _, shell = build_oyster(streams.generator("shell", state), state, slenderness)
    scale = height / shell.extent[0]
    colours = np.round(255 * _srgb(_albedo(shell.mesh, streams.generator("colour")))).astype(np.uint8)
    solid = trimesh.Trimesh(
        shell.mesh.vertices.astype(float) * scale, shell.mesh.faces, vertex_colors=colours, process=False
    )
    data: Any = solid.export(file_type=suffix[1:])
    write_atomically(path, data.encode() if isinstance(data, str) else data)
    length, width = (scale * extent for extent in shell.extent[1:])
    return {
        "height_m": height,
        "length_m": length,
        "width_m": width,
        "volume_m3": shell.volume * scale**3,
        "triangles": len(shell.mesh.faces),
        "watertight": bool(solid.is_watertight),
    }


def _albedo(mesh: Mesh, generator: np.random.Generator) -> NDArray[np.float64]:
    """Linear albedo (V, 3) of a clean shell: growth bands outside, pale with a dark scar inside."""
    growth, inside, scar = (mesh.marks[:, k, None].astype(float) for k in range(3))
    mix = generator.uniform(0.2, 0.8)
    bands = 0.5 + 0.5 * np.sin(2 * np.pi * generator.uniform(7, 12) * growth + generator.uniform(0, 6))
    outer = (mix * BROWN + (1 - mix) * GREY) * (0.75 + 0.35 * bands)
    outer = outer + (PALE - outer) * np.clip(6 * (growth - 0.85), 0, 0.7)
    inner = INSIDE + (SCAR - INSIDE) * 0.8 * scar
    return np.asarray(outer + (inner - outer) * inside)


def _srgb(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert linear values from 0 to 1 to sRGB (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
