"""How the vehicle moves: the keys of a path, which kind of path reads which, and checks across keys."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.keys import choice, number

LOOP_RIPPLE = 0.25
"""The radius of a loop varies by this share of its mean."""

KEYS_OF_KIND: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "loop": (("radius_m",), ()),
    "lawnmower": (
        ("length_m", "width_m", "spacing_m"),
        ("centre_m", "heading_deg", "cross", "repeat", "turn_rate_deg_s"),
    ),
    "transect": (("length_m",), ("centre_m", "heading_deg", "repeat", "turn_rate_deg_s")),
    "orbit": (("radius_m",), ("centre_m", "look", "rings", "spacing_m", "turn_rate_deg_s")),
    "inspection": ((), ("spots", "spots_m", "stand_off_m", "close_m", "sides", "hover_s", "turn_rate_deg_s")),
    "waypoints": (("waypoints",), ("repeat", "turn_rate_deg_s")),
    "free": (("extent_m",), ("revisit", "turn_rate_deg_s")),
}
"""Kind of path -> the keys that it needs, and further ones that it reads; keys listed for no kind are read by all."""

PATH_KINDS = tuple(KEYS_OF_KIND)
LOOKS = ("along", "inward")
RESTS = ("still", "hovering")

Place = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class PathRecipe:
    """How the vehicle moves: from rest along a path over the reef, with the small motions of a hovering ROV.

    Directions from east, counter-clockwise. Keys that a kind does not read (KEYS_OF_KIND) are refused.
    """

    kind: str = choice(PATH_KINDS)  # shape of the path
    speed_m_s: float = number(0.01, 5)  # cruising speed: lower in tight turns and at close range
    ramp_s: float = number(0.5, 60, 3.0)  # time from rest to full speed
    rest_s: float = number(0, 60, 0.0)  # time at rest before setting off, as at the start of most logs
    resting: str = choice(RESTS, "still")
    """Behaviour during that time: still, as if on the bottom, or hovering with the sway below."""
    hand_flown: float = number(0, 2, 0.0)  # stops, drifts and corrections of a human pilot; 1: typical
    altitude_m: float = number(0.2, 20)  # above the smoothed bottom
    sway_m: float = number(0, 0.5, 0.06)  # amplitude of surge, sway and heave about the nominal path
    tilt_deg: float = number(0, 30, 4.0)  # amplitude of roll, pitch and yaw about the nominal attitude
    clearance_m: float = number(0, 10, 0.3)  # least distance of oysters and stones from the body's origin
    lift: bool = False  # rise over obstacles instead of refusing the path
    excitation: float = number(0, 3, 0.0)  # opening manoeuvre by which a filter initialises; 1: 0.08 m and 6 degrees
    lean: float = number(0, 3, 0.0)
    """Pitch and roll caused by drag and acceleration; 1: as a BlueROV2 with low thrusters."""
    wave_following: float = number(0, 1, 1.0)  # share of the wave motion of the water that carries the vehicle along
    hold_s: float = number(0, 20, 1.0)
    """Time for which changes of the current carry the vehicle before it holds its position."""

    turn_rate_deg_s: float = number(1, 180, 30.0)  # fastest turn of the nominal heading
    radius_m: float | None = number(0.2, 100, None)  # loop: mean radius; orbit: that of the innermost circle
    centre_m: tuple[float, float] = number(-100, 100, (0.0, 0.0))  # lawnmower, transect, orbit: centre
    heading_deg: float = number(-360, 360, 0.0)  # direction of the first lane, or of the transect
    length_m: float | None = number(0.5, 200, None)  # length of the lanes, or of the transect
    width_m: float | None = number(0, 200, None)  # lawnmower: greatest extent across the lanes
    spacing_m: float | None = number(0.05, 100, None)  # between lanes, or between the circles of an orbit
    cross: bool = False  # lawnmower: then a second set of lanes across the first, which revisits every lane
    repeat: bool = False
    """Transect, lawnmower: back and forth; waypoints: round and round; otherwise it hovers at the end."""
    look: str = choice(LOOKS, "along")  # orbit: along the path, or inward at the centre
    rings: int = number(1, 100, 1)  # orbit: number of circles, spacing_m apart, one lap on each, outwards and back
    spots: int = number(1, 100, 3)  # inspection: number of spots, drawn from where most stands on the bottom
    spots_m: tuple[Place, ...] = number(-100, 100, ())  # inspection: instead, these spots [x, y], in this order
    stand_off_m: float = number(0.1, 10, 0.8)  # inspection: horizontal distance to the spot
    close_m: float = number(0.1, 20, 0.7)  # inspection: altitude at a spot
    sides: int = number(1, 16, 3)  # inspection: number of directions, evenly spaced, from which a spot is viewed
    hover_s: float = number(0, 600, 3.0)  # inspection: time on each side
    waypoints: tuple[Place, ...] = number(-360, 360, ())  # [x, y], [x, y, altitude] or [x, y, altitude, yaw_deg]
    extent_m: float | None = number(0.5, 200, None)  # free: side of the square about the origin within which it wanders
    revisit: float = number(0, 1, 0.5)  # free: share of the legs that lead to places it has visited


def check_path(path: PathRecipe, size_m: float, where: str) -> None:
    """Check what no single key of a path can express, over a square reef of side size_m.

    Raises RecipeError, which starts with `where`, for a key that the kind lacks or does not read, and for a path that
    leaves the reef.
    """
    needed, read = KEYS_OF_KIND[path.kind]
    of_kinds = {key for keys in KEYS_OF_KIND.values() for some in keys for key in some}
    for field in dataclasses.fields(path):
        if field.name in needed and getattr(path, field.name) == field.default:
            raise RecipeError(f"{where}: missing key 'path.{field.name}', which kind = {path.kind!r} needs")
        if field.name in of_kinds - {*needed, *read} and getattr(path, field.name) != field.default:
            raise RecipeError(
                f"{where}: key 'path.{field.name}': kind = {path.kind!r} does not read it; expected only "
                f"{', '.join((*needed, *read))} and what every kind reads. A key in [defaults] is a key of every "
                "sequence: state it in those that read it"
            )
    if path.kind == "orbit" and path.rings > 1 and path.spacing_m is None:
        raise RecipeError(f"{where}: missing key 'path.spacing_m', which rings = {path.rings} need")
    _check_lists(path, where)
    half = size_m / 2 - 2 * path.sway_m
    if path.kind == "loop":
        room = size_m / 2 / (1 + LOOP_RIPPLE) - 2 * path.sway_m
        _check_reach("radius_m", path.radius_m or 0.0, room, size_m, where)
    elif path.kind == "orbit":
        room = half - max(map(abs, path.centre_m)) - (path.rings - 1) * (path.spacing_m or 0.0)
        _check_reach("radius_m", path.radius_m or 0.0, room, size_m, where)
    elif path.kind == "free":
        _check_reach("extent_m", path.extent_m or 0.0, 2 * half, size_m, where)
    elif path.kind == "inspection":
        reach = max((abs(value) for spot in path.spots_m for value in spot), default=0.0)
        _check_reach("stand_off_m", path.stand_off_m, half - reach, size_m, where)
    key = "waypoints" if path.kind == "waypoints" else "length_m"
    for x, y in corners(path):
        if max(abs(x), abs(y)) > half:
            raise RecipeError(
                f"{where}: key 'path.{key}': the path leaves the reef; expected x and y within -{half:.3g} and "
                f"{half:.3g} for reef.size_m = {size_m:g}, got {x:.3g}, {y:.3g}"
            )


def corners(path: PathRecipe) -> Iterator[tuple[float, float]]:
    """Yield x, y (m) of the outermost points of a path of straight lines."""
    if path.kind == "waypoints":
        yield from ((place[0], place[1]) for place in path.waypoints)
    if path.kind not in ("lawnmower", "transect"):
        return
    turn = (path.spacing_m or 0.0) / 2
    boxes = [((path.length_m or 0.0) / 2 + turn, (path.width_m or 0.0) / 2)]
    if path.cross:
        boxes.append(((path.length_m or 0.0) / 2, (path.width_m or 0.0) / 2 + turn))
    cos, sin = math.cos(math.radians(path.heading_deg)), math.sin(math.radians(path.heading_deg))
    for along, across in boxes:
        for u, v in ((along, across), (along, -across), (-along, across), (-along, -across)):
            yield path.centre_m[0] + u * cos - v * sin, path.centre_m[1] + u * sin + v * cos


def _check_lists(path: PathRecipe, where: str) -> None:
    for spot in path.spots_m:
        if len(spot) != 2:
            raise RecipeError(f"{where}: key 'path.spots_m': expected pairs [x, y], got {list(spot)}")
    for place in path.waypoints:
        if not 2 <= len(place) <= 4:
            raise RecipeError(
                f"{where}: key 'path.waypoints': expected [x, y], [x, y, altitude] or [x, y, altitude, yaw_deg], "
                f"got {list(place)}"
            )
        if len(place) > 2 and not 0 < place[2] <= 20:
            raise RecipeError(
                f"{where}: key 'path.waypoints': expected altitudes above 0 and up to 20, got {place[2]:g} "
                f"in {list(place)}"
            )


def _check_reach(key: str, value: float, room: float, size_m: float, where: str) -> None:
    if value > room:
        raise RecipeError(
            f"{where}: key 'path.{key}': the path leaves the reef; expected at most {room:.3g} for reef.size_m = "
            f"{size_m:g}, got {value:g}"
        )
