"""Patterns of surfaces: keyed by 32 bits in public renders, and by twice as many where there is a salt."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from oysterbench.core.streams import Streams
from oysterbench.render.noise import MIX_1, MIX_2, PRIME_X, PRIME_Y, PRIME_Z, key_of, lattice, noise2, nth
from oysterbench.render.target import start_warp

SEED, POINTS = 2**32 - 5, [(0, 0, 0), (3, -7, 11), (-(10**6), 10**6, 2)]


@wp.kernel
def hashes(points: wp.array(dtype=wp.vec3i), seed: wp.vec2ui, n: int, found: wp.array(dtype=wp.uint32)):  # type: ignore[valid-type]
    k = wp.tid()
    p = points[k]
    found[k] = lattice(p[0], p[1], p[2], nth(seed, n))


@wp.kernel
def pattern(seed: wp.vec2ui, found: wp.array(dtype=wp.float32)):  # type: ignore[valid-type]
    k = wp.tid()
    found[k] = noise2(0.37 * wp.float32(k), 0.21 * wp.float32(k), seed)[0]


def mixed(h: int) -> int:
    for shift, factor in ((16, int(MIX_1.value)), (15, int(MIX_2.value))):
        h ^= h >> shift
        h = h * factor % 2**32
    return h ^ h >> 16


def expected(point: tuple[int, int, int], first: int, second: int) -> int:
    h = first
    for value, prime in zip(point, (PRIME_X, PRIME_Y, PRIME_Z), strict=True):
        h ^= value * int(prime.value) % 2**32
    h = mixed(h)
    return mixed(h ^ second) if second else h


@pytest.mark.parametrize("n", [0, 9])
@pytest.mark.parametrize("second", [0, 123456789])
def test_a_lattice_point_is_hashed_with_all_of_the_key(n: int, second: int) -> None:
    start_warp()
    found = wp.zeros(len(POINTS), dtype=wp.uint32, device="cpu")
    points = wp.array(POINTS, dtype=wp.vec3i, device="cpu")
    wp.launch(hashes, len(POINTS), [points, wp.vec2ui(SEED, second), n, found], device="cpu")
    assert found.numpy().tolist() == [expected(point, (SEED + n) % 2**32, second) for point in POINTS]


def test_a_salt_has_patterns_that_no_seed_of_32_bits_gives() -> None:
    start_warp()
    keys = [key_of(SEED, Streams(SEED, salt), "looks") for salt in (b"", b"one salt", b"another")]
    other = key_of(SEED, Streams(SEED, b"one salt"), "shade")
    words = np.array([*keys, other], dtype=np.int64)
    assert words[:, 0].tolist() == [SEED] * 4
    assert words[0, 1] == 0
    assert len(set(words[:, 1])) == 4
    patterns = []
    for key in keys:
        found = wp.zeros(500, dtype=wp.float32, device="cpu")
        wp.launch(pattern, 500, [key, found], device="cpu")
        patterns.append(found.numpy())
    assert np.abs(np.corrcoef(patterns) - np.eye(3)).max() < 0.2
