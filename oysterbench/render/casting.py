"""Ray casting into a world: the seabed's relief and skirt, and a tree of boxes over instances, each in its own frame.

Every ray sensor uses these functions. A ray is origin + t * direction; the direction need not have unit length, and t
is in units of its length.
"""

from __future__ import annotations

import warp as wp

from oysterbench.render.arithmetic import greater, lesser
from oysterbench.render.relief import Relief, cast_relief, over_relief, relief_normal
from oysterbench.render.tree import Library, Tree
from oysterbench.render.walk import MISSED, NO_FACE, Depths, Waiting, box_depths, inverse, strike_mesh

NOTHING = wp.constant(-1)
RELIEF = wp.constant(-2)
SKIRT = wp.constant(-3)
VEHICLE = wp.constant(-4)

FAR_M = wp.constant(150.0)  # beyond the skirt of every seabed


@wp.struct
class Placed:
    """An instance: a point p in `map` is to_shape * (p - position) in its mesh; rotation and scale belong to its pose.

    root: root of its mesh's tree in Geometry.library. first_corner: where its mesh's corners start in Geometry.corners.
    number: id in instance images. The rest is for shading.
    """

    to_shape: wp.mat33
    position: wp.vec3
    root: wp.int32
    rotation: wp.mat33
    scale: wp.vec3
    first_corner: wp.int32
    colour: wp.vec3
    silt: wp.float32
    kind: wp.uint8
    number: wp.uint16


@wp.struct
class Vehicle:
    """The rig's body at its current pose: rotation from base_link to `map`; mesh 0 for none. marks are albedos.

    radius: of the bounding sphere about the origin, m; low, high: corners of the bounding box. number: id in instance
    images.
    """

    mesh: wp.uint64
    corners: wp.array(dtype=wp.int32)
    normals: wp.array(dtype=wp.vec3)
    marks: wp.array(dtype=wp.vec3)
    rotation: wp.mat33
    position: wp.vec3
    radius: wp.float32
    low: wp.vec3
    high: wp.vec3
    number: wp.uint16


@wp.struct
class Geometry:
    """A world on a device. Corners, points, normals and marks of all library meshes are concatenated.

    placed: instances at rest, in `tree` and, as a Warp tree, in `boxes`; then, from first_swaying, the swaying plants,
    in the tree `swaying`; then, from first_roaming, roaming things, in the tree `roaming` (placed by movers.py).
    shaded: cells of a grid over the reef, indexed [y, x], where roaming things may block the sun.
    """

    relief: Relief
    skirt: wp.uint64
    skirt_corners: wp.array(dtype=wp.int32)
    skirt_normals: wp.array(dtype=wp.vec3)
    boxes: wp.uint64
    tree: Tree
    library: Library
    count: wp.int32
    placed: wp.array(dtype=Placed)
    swaying: wp.uint64
    swaying_count: wp.int32
    first_swaying: wp.int32
    roaming: wp.uint64
    roaming_count: wp.int32
    first_roaming: wp.int32
    shaded: wp.array2d(dtype=wp.uint8)
    shaded_start: wp.float32
    shaded_step: wp.float32
    corners: wp.array(dtype=wp.int32)
    points: wp.array(dtype=wp.vec3)
    normals: wp.array(dtype=wp.vec3)
    marks: wp.array(dtype=wp.vec3)
    vehicle: Vehicle


@wp.struct
class Hit:
    """Nearest surface: instance is its row, or RELIEF, SKIRT, VEHICLE or NOTHING; u, v are the weights of the face's
    first two corners."""

    t: wp.float32
    instance: wp.int32
    face: wp.int32
    u: wp.float32
    v: wp.float32


@wp.func
def near_vehicle(vehicle: Vehicle, origin: wp.vec3, direction: wp.vec3):
    """Whether the line of a ray passes through the sphere around the vehicle."""
    across = wp.cross(vehicle.position - origin, direction)
    return wp.dot(across, across) < vehicle.radius * vehicle.radius * wp.dot(direction, direction)


@wp.func
def meets_box(low: wp.vec3, high: wp.vec3, origin: wp.vec3, direction: wp.vec3):
    """Whether a ray meets a box, by the slab method."""
    enter = wp.float32(0.0)
    leave = wp.float32(FAR_M)
    for axis in range(3):
        along = direction[axis]
        if wp.abs(along) < 1.0e-12:
            along = wp.float32(1.0e-12)
        a = (low[axis] - origin[axis]) / along
        b = (high[axis] - origin[axis]) / along
        enter = greater(enter, lesser(a, b))
        leave = lesser(leave, greater(a, b))
    return enter <= leave


@wp.func
def cast_instance(world: Geometry, i: int, origin: wp.vec3, direction: wp.vec3, max_t: float):
    """Hit of a ray on instance i; NOTHING if there is none before max_t."""
    hit = Hit()
    hit.t = max_t
    hit.instance = NOTHING
    to_shape = world.placed[i].to_shape
    start = to_shape * (origin - world.placed[i].position)
    found = strike_mesh(world.library, world.placed[i].root, start, to_shape * direction, max_t, 0)
    if found.face != NO_FACE:
        hit.t = found.t
        hit.instance = i
        hit.face = found.face
        hit.u = found.u
        hit.v = found.v
    return hit


@wp.func
def cast_vehicle(vehicle: Vehicle, origin: wp.vec3, direction: wp.vec3, max_t: float):
    """Hit of a ray on the vehicle, if there is one; NOTHING if there is none before max_t."""
    hit = Hit()
    hit.t = max_t
    hit.instance = NOTHING
    if vehicle.mesh != wp.uint64(0):  # noqa: SIM102 - Warp evaluates both sides of an `and`
        if near_vehicle(vehicle, origin, direction):
            back = wp.transpose(vehicle.rotation)
            start = back * (origin - vehicle.position)
            along = back * direction
            if meets_box(vehicle.low, vehicle.high, start, along):
                body = wp.mesh_query_ray(vehicle.mesh, start, along, max_t)
                if body.result:
                    hit.t = body.t
                    hit.instance = VEHICLE
                    hit.face = body.face
                    hit.u = body.u
                    hit.v = body.v
    return hit


@wp.func
def cast_surface(world: Geometry, surface: int, origin: wp.vec3, direction: wp.vec3, max_t: float):
    """Hit of a ray on one instance, or the vehicle; NOTHING for other surfaces, or if there is none before max_t."""
    hit = Hit()
    hit.t = max_t
    hit.instance = NOTHING
    if surface >= 0:
        hit = cast_instance(world, surface, origin, direction, max_t)
    elif surface == VEHICLE:
        hit = cast_vehicle(world.vehicle, origin, direction, max_t)
    return hit


@wp.func
def near_roaming(world: Geometry, origin: wp.vec3, direction: wp.vec3, max_t: float):
    """Whether a ray meets the box of any roaming thing before max_t."""
    near = wp.bool(False)
    if world.roaming_count > 0:
        query = wp.bvh_query_ray(world.roaming, origin, direction)
        i = wp.int32(0)
        near = wp.bvh_query_next(query, i, max_t)
    return near


@wp.func
def cast_instances(world: Geometry, origin: wp.vec3, direction: wp.vec3, known: Hit, any: int):
    """Nearest of a known hit and the instances at rest on a ray; with `any`, the first instance found."""
    hit = known
    back = inverse(direction)
    waiting = Waiting()
    depths = Depths()
    count = wp.int32(0)
    item = wp.int32(0)
    going = wp.bool(True)
    while going:
        nearest = wp.float32(MISSED)
        if item < 0:
            i = -1 - item
            to_shape = world.placed[i].to_shape
            start = to_shape * (origin - world.placed[i].position)
            found = strike_mesh(world.library, world.placed[i].root, start, to_shape * direction, hit.t, any)
            if found.face != NO_FACE:
                hit.t = found.t
                hit.instance = i
                hit.face = found.face
                hit.u = found.u
                hit.v = found.v
                if any != 0:
                    count = wp.int32(0)
        else:
            t = box_depths(world.tree.planes, item, origin, back, hit.t)
            children = world.tree.children[item]
            for k in range(4):
                if t[k] < MISSED:
                    if t[k] < nearest:
                        if nearest < MISSED:
                            waiting[count] = item
                            depths[count] = nearest
                            count += 1
                        nearest = t[k]
                        item = children[k]
                    else:
                        waiting[count] = children[k]
                        depths[count] = t[k]
                        count += 1
        going = nearest < MISSED
        while count > 0 and not going:
            count -= 1
            if depths[count] < hit.t:
                item = waiting[count]
                going = wp.bool(True)
    return hit


@wp.func
def under_roaming(world: Geometry, p: wp.vec3):
    """False only if no roaming thing can be between a point and the sun."""
    under = wp.bool(False)
    if world.roaming_count > 0:
        i = int(wp.floor((p[1] - world.shaded_start) / world.shaded_step))
        j = int(wp.floor((p[0] - world.shaded_start) / world.shaded_step))
        under = wp.bool(True)
        if i >= 0 and j >= 0 and i < world.shaded.shape[0] and j < world.shaded.shape[1]:
            under = world.shaded[i, j] != wp.uint8(0)
    return under


@wp.func
def cast_moving(world: Geometry, tree: wp.uint64, first: int, origin: wp.vec3, direction: wp.vec3, nearest: Hit):
    """Nearest of a known hit and the rows from `first` on, which have their own tree, on a ray."""
    hit = nearest
    query = wp.bvh_query_ray(tree, origin, direction)
    i = wp.int32(0)
    while wp.bvh_query_next(query, i, hit.t):
        nearer = cast_instance(world, first + i, origin, direction, hit.t)
        if nearer.instance != NOTHING:
            hit = nearer
    return hit


@wp.func
def blocked_by_moving(world: Geometry, tree: wp.uint64, first: int, origin: wp.vec3, direction: wp.vec3, max_t: float):
    """Whether any of the rows from `first` on, which have their own tree, lies on a ray before max_t."""
    query = wp.bvh_query_ray(tree, origin, direction)
    i = wp.int32(0)
    while wp.bvh_query_next(query, i, max_t):
        row = first + i
        to_shape = world.placed[row].to_shape
        start = to_shape * (origin - world.placed[row].position)
        along = to_shape * direction
        if strike_mesh(world.library, world.placed[row].root, start, along, max_t, 1).face != NO_FACE:
            return True
    return False


@wp.func
def cast(world: Geometry, origin: wp.vec3, direction: wp.vec3, max_t: float):
    """Nearest hit of a ray in the world; NOTHING if there is none before max_t."""
    hit = Hit()
    hit.t = max_t
    hit.instance = NOTHING
    t = cast_relief(world.relief, origin, direction, max_t)
    if t >= 0.0:
        hit.t = t
        hit.instance = RELIEF
    if t < 0.0 or not over_relief(world.relief, origin):
        ground = wp.mesh_query_ray(world.skirt, origin, direction, hit.t)
        if ground.result:
            hit.t = ground.t
            hit.instance = SKIRT
            hit.face = ground.face
            hit.u = ground.u
            hit.v = ground.v
    if world.count > 0:
        hit = cast_instances(world, origin, direction, hit, 0)
    if world.swaying_count > 0:
        hit = cast_moving(world, world.swaying, world.first_swaying, origin, direction, hit)
    if world.roaming_count > 0:
        hit = cast_moving(world, world.roaming, world.first_roaming, origin, direction, hit)
    body = cast_vehicle(world.vehicle, origin, direction, hit.t)
    if body.instance != NOTHING:
        hit = body
    return hit


@wp.func
def blocked_by_vehicle(vehicle: Vehicle, origin: wp.vec3, direction: wp.vec3, max_t: float):
    """Whether the vehicle, if there is one, lies on a ray before max_t."""
    if vehicle.mesh != wp.uint64(0):  # noqa: SIM102 - Warp evaluates both sides of an `and`
        if near_vehicle(vehicle, origin, direction):
            back = wp.transpose(vehicle.rotation)
            start = back * (origin - vehicle.position)
            along = back * direction
            if meets_box(vehicle.low, vehicle.high, start, along):
                return wp.mesh_query_ray_anyhit(vehicle.mesh, start, along, max_t)
    return False


@wp.func
def blocked(world: Geometry, origin: wp.vec3, direction: wp.vec3, max_t: float, with_seabed: int):
    """Whether anything lies on a ray before max_t."""
    if with_seabed != 0 and cast_relief(world.relief, origin, direction, max_t) >= 0.0:
        return True
    if world.count > 0:
        hit = Hit()
        hit.t = max_t
        hit.instance = NOTHING
        if cast_instances(world, origin, direction, hit, 1).instance != NOTHING:
            return True
    if world.swaying_count > 0:  # noqa: SIM102 - Warp evaluates both sides of an `and`
        if blocked_by_moving(world, world.swaying, world.first_swaying, origin, direction, max_t):
            return True
    if world.roaming_count > 0:  # noqa: SIM102
        if blocked_by_moving(world, world.roaming, world.first_roaming, origin, direction, max_t):
            return True
    return blocked_by_vehicle(world.vehicle, origin, direction, max_t)


@wp.func
def blend(normals: wp.array(dtype=wp.vec3), corners: wp.array(dtype=wp.int32), first: int, u: float, v: float):
    """Mean of the vertex normals (or points, or marks) of the face whose corners start at `first`, with weights u, v
    and 1 - u - v."""
    a = normals[corners[first]]
    b = normals[corners[first + 1]]
    c = normals[corners[first + 2]]
    return a * u + b * v + c * (1.0 - u - v)


@wp.func
def surface_normal(world: Geometry, hit: Hit, p: wp.vec3):
    """Smooth unit normal in `map` at a hit at point p, outward."""
    normal = wp.vec3(0.0, 0.0, 1.0)
    if hit.instance == RELIEF:
        normal = relief_normal(world.relief, p)
    elif hit.instance == SKIRT:
        normal = blend(world.skirt_normals, world.skirt_corners, 3 * hit.face, hit.u, hit.v)
    elif hit.instance >= 0:
        first = world.placed[hit.instance].first_corner + 3 * hit.face
        local = blend(world.normals, world.corners, first, hit.u, hit.v)
        normal = world.placed[hit.instance].rotation * wp.cw_div(local, world.placed[hit.instance].scale)
        if world.swaying_count > 0 and hit.instance >= world.first_swaying:  # also sheared
            normal = wp.transpose(world.placed[hit.instance].to_shape) * local
    elif hit.instance == VEHICLE:
        body = blend(world.vehicle.normals, world.vehicle.corners, 3 * hit.face, hit.u, hit.v)
        normal = world.vehicle.rotation * body
    return wp.normalize(normal)
