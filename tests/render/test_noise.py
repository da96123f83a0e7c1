"""Patterns: keyed by 32 bits in public renders, and by twice as many where there is a salt."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import warp as wp

from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe
from oysterbench.render.noise import (
    MIX_1,
    MIX_2,
    MIX_3,
    MIX_4,
    PRIME_X,
    PRIME_Y,
    PRIME_Z,
    key_of,
    lattice,
    noise2,
    nth,
    own_hash,
)
from oysterbench.render.optics import Optics, caustic
from oysterbench.render.snow import Snow
from oysterbench.render.target import start_warp
from oysterbench.render.water import Water

SEED, POINTS = 2**32 - 5, [(0, 0, 0), (3, -7, 11), (-(10**6), 10**6, 2)]


@wp.kernel
def hashes(points: wp.array(dtype=wp.vec3i), seed: wp.vec2ui, n: int, found: wp.array(dtype=wp.uint32)):  # type: ignore[valid-type]
    k = wp.tid()
    p = points[k]
    found[k] = lattice(p[0], p[1], p[2], nth(seed, n))


@wp.kernel
def own_hashes(seeds: wp.array(dtype=wp.vec2ui), found: wp.array(dtype=wp.uint32)):  # type: ignore[valid-type]
    found[wp.tid()] = own_hash(seeds[wp.tid()])


@wp.kernel
def sunlight(optics: Optics, found: wp.array(dtype=wp.float32)):  # type: ignore[valid-type]
    k = wp.tid()
    found[k] = caustic(optics, wp.vec3(0.37 * wp.float32(k), 0.21 * wp.float32(k), -1.0))


@wp.kernel
def pattern(seed: wp.vec2ui, found: wp.array(dtype=wp.float32)):  # type: ignore[valid-type]
    k = wp.tid()
    found[k] = noise2(0.37 * wp.float32(k), 0.21 * wp.float32(k), seed)[0]


def mixed(h: int) -> int:
    for shift, factor in ((16, int(MIX_1.value)), (15, int(MIX_2.value))):
        h ^= h >> shift
        h = h * factor % 2**32
    return h ^ h >> 16


def mixed64(h: int) -> int:
    for shift, factor in ((30, int(MIX_3.value)), (27, int(MIX_4.value))):
        h ^= h >> shift
        h = h * factor % 2**64
    return h ^ h >> 31


def expected(point: tuple[int, int, int], first: int, second: int) -> int:
    x, y, z = (
        value * int(prime.value) % 2**32 for value, prime in zip(point, (PRIME_X, PRIME_Y, PRIME_Z), strict=True)
    )
    if second:
        key = first << 32 | second
        place = (point[0] % 2**32 ^ z) << 32 | point[1] % 2**32
        return mixed64(mixed64((mixed64(place ^ key) + key) % 2**64) ^ key) >> 32
    return mixed(x ^ y ^ z ^ first)


@pytest.mark.parametrize("n", [0, 9])
@pytest.mark.parametrize("second", [0, 123456789])
def test_a_lattice_point_is_hashed_with_all_of_the_key(n: int, second: int) -> None:
    start_warp()
    found = wp.zeros(len(POINTS), dtype=wp.uint32, device="cpu")
    points = wp.array(POINTS, dtype=wp.vec3i, device="cpu")
    wp.launch(hashes, len(POINTS), [points, wp.vec2ui(SEED, second), n, found], device="cpu")
    assert found.numpy().tolist() == [expected(point, (SEED + n) % 2**32, second) for point in POINTS]


def test_all_of_a_point_and_of_a_key_of_64_bits_changes_every_bit_of_a_hash() -> None:
    start_warp()
    base = (17, -40, 2, 2**31 + 12345, 987654321)
    changes = [(k, bit) for k in (0, 1, 2, 3, 4) for bit in range(32)]
    flipped = np.zeros((len(changes), 32))
    for n in range(40):
        words = [value % 2**32 ^ 7919 * n for value in base]
        cases = [list(words)] + [[value ^ (i == k) << bit for i, value in enumerate(words)] for k, bit in changes]
        whole = [expected((x, y, z), first, second) for x, y, z, first, second in cases]
        flipped += [[(value ^ whole[0]) >> bit & 1 for bit in range(32)] for value in whole[1:]]
    assert flipped.min() / 40 > 0.1
    assert flipped.max() / 40 < 0.9
    assert abs(flipped.mean() / 40 - 0.5) < 0.005


SALTS = (b"one salt", b"another")


def words_of(key: wp.vec2ui) -> list[int]:
    words: list[int] = np.array(key, dtype=np.int64).tolist()
    return words


def test_a_salt_has_patterns_that_no_seed_of_32_bits_gives() -> None:
    start_warp()
    assert words_of(key_of(SEED, Streams(SEED), "looks")) == [SEED, 0]
    keys = [key_of(SEED, Streams(SEED, salt), name) for salt in SALTS for name in ("looks", "shade", "layers")]
    words = [word for key in keys for word in words_of(key)]
    assert len({0, SEED, *words}) == len(words) + 2, "no half of a key is public, or that of another"
    patterns = []
    for key in [key_of(SEED, Streams(SEED), "looks"), *keys]:
        found = wp.zeros(500, dtype=wp.float32, device="cpu")
        wp.launch(pattern, 500, [key, found], device="cpu")
        patterns.append(found.numpy())
    assert np.abs(np.corrcoef(patterns) - np.eye(len(patterns))).max() < 0.25


def test_what_a_key_alone_decides_is_decided_by_all_of_it() -> None:
    """Which shells have barnacles, say."""
    start_warp()
    seeds = [(SEED, second) for second in range(1000)]
    found = wp.zeros(1000, dtype=wp.uint32, device="cpu")
    wp.launch(own_hashes, 1000, [wp.array(seeds, dtype=wp.vec2ui, device="cpu"), found], device="cpu")
    assert found.numpy()[0] == SEED
    assert len(set((found.numpy() >> 8 & 255).tolist())) > 200


def test_layers_of_caustics_are_mixed_by_a_key_of_their_own() -> None:
    start_warp()
    optics = Optics()
    optics.sun_direction = wp.vec3(0.0, 0.0, 1.0)
    optics.caustics.on, optics.caustics.period, optics.caustics.fade_step = 1, 4.0, 10.0
    optics.caustics.fade = wp.ones(2, dtype=wp.float32, device="cpu")
    tile = np.random.default_rng(1).random((16, 16)).astype(np.float32)
    optics.caustics.tile = wp.array(tile, dtype=wp.float32, device="cpu")
    light = []
    for seed, shade in (((0, 0), (1, 2)), ((0, 0), (3, 4)), ((5, 6), (1, 2)), ((7, 6), (1, 2))):
        optics.caustics.seed, optics.shade_seed = wp.vec2ui(*seed), wp.vec2ui(*shade)
        found = wp.zeros(100, dtype=wp.float32, device="cpu")
        wp.launch(sunlight, 100, [optics, found], device="cpu")
        light.append(found.numpy())
    assert np.array_equal(light[0], light[1])
    assert min(np.abs(light[k] - light[2]).max() for k in (0, 3)) > 0.1


def snow_with(salt: bytes) -> Snow:
    start_warp()
    water = cast("Water", SimpleNamespace(absorption=np.full(3, 0.1), scattering=np.full(3, 0.2)))
    return Snow(
        300.0,
        CameraRecipe(name="cam", width=64, height=48, rate_hz=5.0, hfov_deg=80.0),
        water,
        Streams(SEED, salt),
        "cpu",
    )


def test_flakes_hang_where_all_of_a_key_says_and_not_in_a_public_field_moved_sideways() -> None:
    y, z = -7, 2
    row = np.array([(x, y, z) for x in range(-20, 20)])
    public, *salted = (snow_with(salt) for salt in (b"", *SALTS))
    first, second = words_of(public._seed)
    assert second == 0
    assert public._hash(row).tolist() == [
        mixed((mixed((mixed((x + first) % 2**32) + y) % 2**32) + z) % 2**32) for x in range(-20, 20)
    ]
    found = []
    for snow in salted:
        a, b = words_of(snow._seed)
        assert snow._hash(row).tolist() == [expected((x, y, z), a, b) for x in range(-20, 20)]
        for seed in ((a, b), ((a + 5) % 2**32, b), (a, (b + 5) % 2**32)):
            snow._seed = wp.vec2ui(*seed)
            found += snow._hash(row).tolist()
    assert len(set(found)) == len(found)


def test_flakes_are_others_with_each_salt() -> None:
    rays = np.stack([*np.meshgrid(np.linspace(-0.8, 0.8, 64), np.linspace(-0.6, 0.6, 48)), np.ones((48, 64))], axis=-1)
    seen = [snow_with(salt).flakes(np.eye(4), rays.astype(np.float32), 0.0) for salt in (*SALTS, *SALTS)]
    for k in (0, 1):
        assert np.array_equal(seen[k][0], seen[k + 2][0])
        assert 300 < len(seen[k][1]) < 5000
    assert len(np.intersect1d(seen[0][1], seen[1][1])) == 0
