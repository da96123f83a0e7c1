"""The body of a vehicle, for cameras that see it: a BlueROV2-class frame with floats, tubes, thrusters and lamps."""

from __future__ import annotations

import numpy as np

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import RigRecipe
from oysterbench.scene.mesh import Mesh, join_meshes
from oysterbench.scene.solids import bent_tube, dome, plate, ring, rounded_box, tube

BLUE, BLACK, GREY = (0.02, 0.10, 0.42), (0.025, 0.025, 0.03), (0.30, 0.31, 0.32)
FLOAT_BLUE, GLASS, YELLOW = (0.04, 0.17, 0.45), (0.10, 0.12, 0.13), (0.55, 0.42, 0.03)

# Outline (x, z) of a side panel, m: bow and stern are tall, with cut-outs at the feet.
SIDE_PANEL = (
    (-0.22, -0.125),
    (0.17, -0.125),
    (0.22, -0.075),
    (0.22, 0.015),
    (0.19, 0.06),
    (-0.19, 0.06),
    (-0.22, 0.02),
)
SIDE_HOLES = ((-0.12, -0.045, 0.042), (0.0, -0.04, 0.042), (0.12, -0.045, 0.042))  # x, z, radius
DUCT_RADIUS_M, DUCT_LENGTH_M = 0.048, 0.05
LEVEL_THRUSTERS = ((0.13, 0.10, 45), (0.13, -0.10, -45), (-0.13, 0.10, -45), (-0.13, -0.10, 45))  # x, y, heading deg
UPRIGHT_THRUSTERS = ((0.0, 0.115), (0.0, -0.115))
LAMPS_Y_M = (-0.12, 0.12)
AHEAD_M = (0.245, 0.0, 0.03)  # of a camera at the bow


def build_vehicle(rig: RigRecipe, with_tether: bool = True) -> Mesh | None:
    """Build the rig's body in base_link, m, with albedos as marks; None for a rig without a body. with_tether: add a
    stiff bend of tether at the stern.

    Dimensions follow the maker's drawing of the BlueROV2: 457 x 338 x 254 mm, a 4-inch and a 3-inch tube along x.
    """
    if rig.vehicle == "none":
        return None
    tether = _tether() if with_tether else []
    return join_meshes([*_frame(), *_floats(), *_tubes(), *_thrusters(), *_lamps(), *tether])


def check_cameras(rig: RigRecipe, where: str) -> None:
    """Raise RecipeError, which starts with `where`, for a camera inside the rig's body: it would see nothing else."""
    body = build_vehicle(rig, with_tether=False)
    for camera in rig.camera:
        if body is not None and body.encloses(camera.position_m):
            raise RecipeError(
                f"{where}: camera {camera.name}: key 'camera.position_m': expected a place outside the body of "
                f"vehicle = {rig.vehicle!r}, such as {list(AHEAD_M)} ahead of its bow, got {list(camera.position_m)}"
            )


def _frame() -> list[Mesh]:
    """Frame: two side panels with round windows, a bottom plate, cross members and feet."""
    parts = []
    for y in (-0.163, 0.163):
        parts.append(plate(np.array(SIDE_PANEL), y, 0.010, BLACK))
        # Windows cannot be cut out of a closed sheet: a rim mounted on it reads as one.
        for x, z, radius in SIDE_HOLES:
            outer = np.copysign(abs(y) + 0.0055, y)
            parts.append(ring((x, outer, z), (0.0, 1.0, 0.0), radius, radius - 0.006, 0.004, BLUE))
    parts.append(rounded_box((0.0, 0.0, -0.120), (0.40, 0.316, 0.008), 0.003, BLACK))
    parts += [rounded_box((x, 0.0, -0.02), (0.012, 0.316, 0.05), 0.004, BLACK) for x in (-0.205, 0.205)]
    parts += [rounded_box((0.0, y, -0.132), (0.40, 0.018, 0.016), 0.006, GREY) for y in (-0.15, 0.15)]
    return parts


def _floats() -> list[Mesh]:
    """Four foam fairings with rounded edges above the frame."""
    places = [(x, y) for x in (-0.125, 0.125) for y in (-0.105, 0.105)]
    return [rounded_box((x, y, 0.083), (0.175, 0.108, 0.070), 0.018, FLOAT_BLUE) for x, y in places]


def _tubes() -> list[Mesh]:
    """Watertight tube with its dome and end cap, and the battery tube below it."""
    return [
        tube((-0.15, 0.0, 0.035), (0.14, 0.0, 0.035), 0.057, GREY),
        *(tube((x, 0.0, 0.035), (x + 0.014, 0.0, 0.035), 0.062, BLACK) for x in (-0.158, 0.134)),
        dome((0.148, 0.0, 0.035), 0.055, GLASS),
        *(tube((-0.158, y, z), (-0.175, y, z), 0.007, BLACK) for y in (-0.02, 0.02) for z in (0.015, 0.055)),
        tube((-0.12, 0.0, -0.072), (0.12, 0.0, -0.072), 0.044, GREY),
        *(tube((x, 0.0, -0.072), (x + 0.012, 0.0, -0.072), 0.048, BLACK) for x in (-0.130, 0.118)),
    ]


def _thrusters() -> list[Mesh]:
    """Six thrusters: a duct, a hub and three blades each."""
    parts = []
    for x, y, heading in LEVEL_THRUSTERS:
        turn = np.deg2rad(heading)
        parts += _thruster((x, y, -0.062), (np.cos(turn), np.sin(turn), 0.0))
    for x, y in UPRIGHT_THRUSTERS:
        parts += _thruster((x, y, 0.075), (0.0, 0.0, 1.0))
    return parts


def _thruster(centre: tuple[float, float, float], axis: tuple[float, float, float]) -> list[Mesh]:
    along = np.array(axis)
    middle = np.array(centre)
    across = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    other = np.cross(along, across)
    parts = [
        ring(middle, axis, DUCT_RADIUS_M, DUCT_RADIUS_M - 0.007, DUCT_LENGTH_M, BLACK),
        tube(middle - 0.024 * along, middle + 0.012 * along, 0.014, BLACK),
        tube(middle + 0.012 * along, middle + 0.026 * along, 0.009, BLUE),
    ]
    for blade in range(3):
        turn = 2 * np.pi * blade / 3 + 0.4
        out = np.cos(turn) * across + np.sin(turn) * other
        side = np.cross(along, out)
        pitched = 0.75 * side + 0.66 * along
        # An ellipse standing on the hub, pitched to the axis.
        half_axes = (0.015 * out, 0.010 * pitched, 0.0015 * np.cross(out, pitched))
        parts.append(dome(middle + 0.027 * out, 1.0, BLUE, half_axes, whole=True))
    return parts


def _lamps() -> list[Mesh]:
    """Lamps under the bow, each with a bright window, placed behind the rig's light source."""
    parts = []
    for y in LAMPS_Y_M:
        parts.append(tube((0.175, y, -0.092), (0.222, y, -0.102), 0.021, BLACK))
        parts.append(tube((0.222, y, -0.102), (0.226, y, -0.103), 0.017, (0.75, 0.74, 0.68)))
        parts.append(tube((0.155, y, -0.088), (0.175, y, -0.092), 0.012, GREY))
        parts.append(rounded_box((0.19, y, -0.113), (0.020, 0.012, 0.020), 0.003, BLACK))
    return parts


def _tether() -> list[Mesh]:
    """Tether that leaves the stern in a slack bend and rises."""
    t = np.linspace(0.0, 1.0, 36)
    x = -0.17 - 0.10 * np.sin(0.5 * np.pi * t) - 0.12 * t**2
    y = 0.02 - 0.30 * t**2 + 0.05 * np.sin(7 * t) * t
    z = 0.05 - 0.05 * np.sin(np.pi * t) + 1.1 * t**2
    path = np.column_stack([x, y, z])
    return [bent_tube(path, 0.0038, YELLOW)]
