"""Routes: each kind of path as an ordered list of places. `loop` is a closed curve without corners to round off."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from oysterbench.core.geometry import Array
from oysterbench.recipe import LOOP_RIPPLE
from oysterbench.scene.path.itinerary import SMOOTHING_S, Itinerary, Pace

ARC_STEP_RAD = np.radians(5.0)
CURVE_STEP_M = 0.05
LOOK_S = 2 * SMOOTHING_S  # time spent at a waypoint's yaw, so that smoothing does not change it
SLOW = 0.4  # share of the speed used close to an inspected spot
WANDER_CHORD = (0.2, 0.6)  # shortest and longest legs of a free path, relative to the extent
MEMORY = 40  # number of places that a free path may revisit
SHARPEST_TURN = np.radians(120.0)  # between two legs of a free path

Places = list[tuple[float, float]]
Curve = tuple[Array, Array]
"""Places (K, 2) m along a curve, and its tangents (K, 2) at these."""


def loop(radius_m: float, travelled_m: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """x, y (m) and heading (rad, unwrapped) at distances travelled_m (N,) along a closed loop around the origin."""
    start, bend = rng.uniform(0.0, 2 * np.pi, 2)
    turn = rng.choice([-1.0, 1.0])
    angle = np.linspace(0.0, 2 * np.pi, 4001)
    # An elliptic and a three-lobed term: curvature changes along the path, so that no part is a plain circle.
    radius = radius_m * (1 + LOOP_RIPPLE * (0.6 * np.sin(2 * angle + bend) + 0.4 * np.sin(3 * angle)))
    curve = np.column_stack([radius * np.cos(start + turn * angle), radius * np.sin(start + turn * angle)])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    closed = make_interp_spline(length, curve, k=5, bc_type="periodic")
    position = closed(travelled_m)
    tangent = closed.derivative(1)(travelled_m)
    return position[:, 0], position[:, 1], np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))


def lanes(
    length_m: float, width_m: float, spacing_m: float, heading: float, centre: tuple[float, float], cross: bool
) -> list[Curve]:
    """Parallel lanes from the right of the centre to its left, joined by half circles at their ends.

    The first lane runs along `heading` (rad), the next against it, and so on; with `cross`, a second set runs across
    them, starting from its nearest corner.
    """
    turned = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    sets = [_meander(length_m, width_m, spacing_m)]
    if cross:
        places, tangents = _meander(width_m, length_m, spacing_m)
        end, start = sets[0][0][-1], places[0, ::-1]
        mirror = np.where(end * start < 0, -1.0, 1.0)
        sets.append((places[:, ::-1] * mirror, tangents[:, ::-1] * mirror))
    return [(np.asarray(centre) + places @ turned, tangents @ turned) for places, tangents in sets]


def _meander(length_m: float, width_m: float, spacing_m: float) -> Curve:
    """Lanes parallel to the first axis, in increasing order along the second, centred on the origin."""
    count = int(np.floor(width_m / spacing_m + 1e-9)) + 1
    turn = np.arange(ARC_STEP_RAD, np.pi - 1e-9, ARC_STEP_RAD)
    bulge = spacing_m / 2 * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    places, tangents = [], []
    for lane in range(count):
        forth = np.array([1.0 if lane % 2 == 0 else -1.0, 1.0])
        middle = np.array([0.0, (lane - (count - 1) / 2) * spacing_m])
        end = np.array([length_m / 2, 0.0])
        places += [middle - forth * end, middle + forth * end]
        tangents += 2 * [forth * [1.0, 0.0]]
        if lane + 1 < count:
            places += list(middle + forth * (end + bulge))
            tangents += list(forth * np.column_stack([np.cos(turn), np.sin(turn)]))
    return np.array(places), np.array(tangents)


def survey(sets: list[Curve], pace: Pace, repeat: bool, seconds: float) -> Itinerary:
    """Itinerary along curves, one after the other; with `repeat`, back and forth until `seconds` have elapsed."""
    back = [(places[::-1], -tangents[::-1]) for places, tangents in reversed(sets)]
    itinerary = _begin(sets[0], pace)
    rounds = 0
    while True:
        for places, tangents in back if rounds % 2 else sets:
            itinerary.line(places[0], pace.altitude)
            _follow(itinerary, (places, tangents))
        rounds += 1
        if not repeat or itinerary.elapsed > seconds:
            return itinerary


def orbit(
    radii_m: list[float],
    centre: tuple[float, float],
    inward: bool,
    pace: Pace,
    seconds: float,
    rng: np.random.Generator,
) -> Itinerary:
    """Itinerary of one lap per circle, outwards and back in, until `seconds` have elapsed; starting angle and direction
    of rotation are drawn from `rng`."""
    angle, side = float(rng.uniform(0.0, 2 * np.pi)), float(rng.choice([-1.0, 1.0]))
    facing = np.pi if inward else side * np.pi / 2
    laps = [_unsmoothed(radius, pace) for radius in radii_m]
    laps = [*laps, *laps[-2:0:-1]]
    turns = side * np.linspace(0.0, 2 * np.pi, int(np.ceil(2 * np.pi / ARC_STEP_RAD)) + 1)

    def states(radius: float, angles: Array) -> Array:
        on = np.column_stack([centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles)])
        return np.column_stack(
            [on, np.full(len(on), pace.altitude), angles + facing, np.full(len(on), float(not inward))]
        )

    itinerary = Itinerary(states(laps[0], np.array([angle]))[0], pace)
    lap = 0
    while itinerary.elapsed <= seconds:
        itinerary.through(states(laps[lap % len(laps)], angle + turns))
        lap += 1
    return itinerary


def _unsmoothed(radius: float, pace: Pace) -> float:
    """Radius of a circle that the smoothing in time shrinks to `radius`, by a factor of exp(-(omega sigma)^2 / 2)."""
    wider = radius
    for _ in range(50):
        omega = min(pace.speed / wider, pace.turn_rate)
        wider = radius * float(np.exp(0.5 * (omega * SMOOTHING_S) ** 2))
    return wider


def inspection(
    spots: Places,
    stand_off: float,
    close: float,
    sides: int,
    hover_s: float,
    pace: Pace,
    seconds: float,
    rng: np.random.Generator,
) -> Itinerary:
    """Itinerary that visits the spots (x, y m) in turn until `seconds` have elapsed.

    At each: approach slowly and descend to the altitude `close`, look at it from the distance `stand_off`, circle it to
    look from all `sides`, hovering for hover_s each time, and rise again.
    """
    out = float(np.hypot(*spots[0]))
    inside = -np.array(spots[0]) / out if out > 0.1 else np.array([1.0, 0.0])
    start = np.array(spots[0]) + min(2 * stand_off + 1.0, out + stand_off) * inside  # never far beyond the centre
    itinerary = Itinerary(np.array([*start, pace.altitude, np.arctan2(-inside[1], -inside[0]), 1.0]), pace)
    visit = 0
    while itinerary.elapsed <= seconds:
        spot = np.array(spots[visit % len(spots)])
        from_spot = itinerary.state[:2] - spot
        away = float(np.hypot(*from_spot))
        outward = from_spot / away if away > 1e-6 else np.array([1.0, 0.0])
        if away > 2 * stand_off:
            itinerary.line(spot + 2 * stand_off * outward, pace.altitude)
        angle = float(np.arctan2(outward[1], outward[0]))
        itinerary.turn(angle + np.pi)
        _look_at(itinerary, spot, np.array([angle]), stand_off, close, SLOW * pace.speed)
        itinerary.wait(hover_s)
        side = float(rng.choice([-1.0, 1.0]))
        for _ in range(sides - 1):
            turn = 2 * np.pi / sides
            arc = angle + side * np.linspace(0.0, turn, int(np.ceil(turn / ARC_STEP_RAD)) + 1)[1:]
            _look_at(itinerary, spot, arc, stand_off, close, SLOW * pace.speed)
            itinerary.wait(hover_s)
            angle += side * turn
        _look_at(itinerary, spot, np.array([angle]), stand_off, pace.altitude, SLOW * pace.speed)
        visit += 1
    return itinerary


def _look_at(itinerary: Itinerary, spot: Array, angles: Array, away: float, altitude: float, speed: float) -> None:
    """Move around a spot through angles (K,) rad at a distance `away`, facing it."""
    n = len(angles)
    on = spot + away * np.column_stack([np.cos(angles), np.sin(angles)])
    itinerary.through(np.column_stack([on, np.full(n, altitude), angles + np.pi, np.zeros(n)]), speed)


def dense_spots(relief: Array, lines: Array, count: int, apart_m: float, rng: np.random.Generator) -> Places:
    """Draw `count` places (x, y m) from the tenth of a grid with the highest relief, as a nearest-neighbour tour.

    relief (N, N) m, indexed [y, x], on grid lines (N,) m: mean height of objects above the bottom. The places are at
    least apart_m from one another as long as the reef has such places; then the distance is reduced step by step.
    """
    order = np.argsort(-np.round(relief, 4), axis=None, kind="stable")[: max(relief.size // 10, count)]
    rows, columns = np.unravel_index(rng.permutation(order), relief.shape)
    free = np.column_stack([lines[columns], lines[rows]])
    drawn = free[:1]
    while len(drawn) < count:
        room = np.min([np.hypot(*(free - spot).T) for spot in drawn], axis=0)
        fitting = np.flatnonzero(room >= apart_m)
        if len(fitting):
            drawn = np.vstack([drawn, free[fitting[0]]])
        else:
            apart_m *= 0.7
    tour = [drawn[0]]
    left = list(drawn[1:])
    while left:
        tour.append(left.pop(int(np.argmin(np.round([np.hypot(*(spot - tour[-1])) for spot in left], 6)))))
    return [(float(x), float(y)) for x, y in tour]


def waypoints(
    places: tuple[tuple[float, ...], ...],
    pace: Pace,
    repeat: bool,
    seconds: float,
) -> Itinerary:
    """Itinerary in straight lines through places [x, y, (altitude m, (yaw deg))], with the bow along the lines.

    Each is passed within 0.15 s of full speed: at 30 deg/s within 0.03 s, or 1.2 cm at 0.4 m/s. At a place with yaw the
    vehicle briefly turns to it; between two such places the heading changes evenly from one yaw to the other.
    With `repeat`, over and over until `seconds` have elapsed.
    """

    def state(place: tuple[float, ...]) -> Array:
        yaw = np.radians(place[3]) if len(place) == 4 else 0.0
        return np.array([*place[:2], place[2] if len(place) > 2 else pace.altitude, yaw, 0.0])

    start = state(places[0])
    others = [place for place in places if np.hypot(place[0] - start[0], place[1] - start[1]) > 1e-6]
    if len(places[0]) < 4 and others:
        start[3:] = np.arctan2(others[0][1] - start[1], others[0][0] - start[0]), 1.0
    itinerary = Itinerary(start, pace)
    previous = places[0]
    following = places[1:]
    while True:
        for place in following:
            if len(previous) == 4 and len(place) == 4:
                itinerary.through(state(place)[None])
            else:
                itinerary.line(state(place)[:2], float(state(place)[2]))
                if len(place) == 4:
                    itinerary.turn(float(np.radians(place[3])))
                    itinerary.wait(LOOK_S)
            previous = place
        following = places
        if not repeat or not others or itinerary.elapsed > seconds:
            return itinerary


def wander(
    extent_m: float,
    revisit: float,
    pace: Pace,
    seconds: float,
    rng: np.random.Generator,
) -> Itinerary:
    """Itinerary of a free path in a square about the origin: a smooth curve along places, some of them revisited.

    The places are the control points of a uniform quadratic B-spline, so that the curve stays inside their hull (de
    Boor 2001, ch. IX) and touches the middle of each leg: whenever it takes the same leg, it passes the same place.
    """
    places = _ramble(extent_m, revisit, pace.speed * seconds, rng)
    curve = BSpline(np.arange(len(places) + 3, dtype=float), places, 2)
    at = np.linspace(2.0, float(len(places)), 100 * (len(places) - 2) + 1)
    on = curve(at)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(on, axis=0).T))])
    even = np.interp(np.arange(0.0, length[-1], CURVE_STEP_M), length, at)
    line = curve(even), curve.derivative(1)(even)
    itinerary = _begin(line, pace)
    _follow(itinerary, line)
    return itinerary


def _ramble(extent_m: float, revisit: float, length_m: float, rng: np.random.Generator) -> Array:
    """Draw places (K, 2) m, new and known ones, whose legs are long enough for the curve to be longer than length_m."""
    half = extent_m / 2
    shortest, longest = WANDER_CHORD[0] * extent_m, WANDER_CHORD[1] * extent_m
    places = [rng.uniform(-half, half, 2)]
    course, walked = np.zeros(2), 0.0
    while walked < 2.5 * length_m + 4 * extent_m or len(places) < 6:
        here = places[-1]
        known, new = np.array(places[:MEMORY]), rng.uniform(-half, half, (64, 2))
        fitting = [
            some[[shortest < np.hypot(*leg) < longest and _bend(course, leg) < SHARPEST_TURN for leg in some - here]]
            for some in (known, new)
        ]
        again, pick = rng.random() < revisit, rng.random()
        # In a corner nothing may fit; from there, a place on the far side of the centre is always far enough.
        choices = next((some for some in (fitting if again else fitting[1:]) if len(some)), -0.3 * here[None])
        places.append(choices[int(pick * len(choices))])
        course = places[-1] - here
        walked += float(np.hypot(*course))
    return np.array(places)


def _bend(before: Array, after: Array) -> float:
    """Angle between two legs, rad."""
    turn = np.arctan2(before[0] * after[1] - before[1] * after[0], before @ after)
    return float(abs(turn))


def _begin(curve: Curve, pace: Pace) -> Itinerary:
    """Start an itinerary at the first place of a curve, with the bow along it."""
    places, tangents = curve
    return Itinerary(np.array([*places[0], pace.altitude, _courses(tangents)[0], 1.0]), pace)


def _follow(itinerary: Itinerary, curve: Curve) -> None:
    """Extend an itinerary along a curve, with the bow along it."""
    places, tangents = curve
    n = len(places)
    states = np.column_stack([places, np.full(n, itinerary.pace.altitude), _courses(tangents), np.ones(n)])
    itinerary.turn(states[0, 3], along=True)
    itinerary.through(states)


def _courses(tangents: Array) -> Array:
    """Courses (K,) rad of tangents (K, 2)."""
    return np.arctan2(tangents[:, 1], tangents[:, 0])
