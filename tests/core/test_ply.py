"""PLY files: written as others read them, read back to the bit."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.ply import read_ply, write_ply

KIND = np.dtype(
    [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("n", "<i4")]
)


@pytest.fixture
def rows():
    rng = np.random.default_rng(3)
    rows = np.zeros(50, dtype=KIND)
    for name in "xyz":
        rows[name] = rng.normal(size=50)
    for name in ("red", "green", "blue", "n"):
        rows[name] = rng.integers(0, 256, 50)
    return rows


def test_what_is_written_comes_back_and_others_read_it(rows, tmp_path):
    write_ply(tmp_path / "a.ply", rows, "fifty points")
    assert read_ply(tmp_path / "a.ply").tolist() == rows.tolist()
    cloud = trimesh.load(tmp_path / "a.ply")
    np.testing.assert_allclose(cloud.vertices, np.column_stack([rows[name] for name in "xyz"]))
    np.testing.assert_array_equal(cloud.colors[:, :3], np.column_stack([rows[n] for n in ("red", "green", "blue")]))


def test_no_points_are_a_file_too(rows, tmp_path):
    write_ply(tmp_path / "a.ply", rows[:0], "none")
    assert len(read_ply(tmp_path / "a.ply")) == 0


def test_another_file_and_a_cut_one_are_named(rows, tmp_path):
    path = tmp_path / "a.ply"
    path.write_text("ply\nformat ascii 1.0\nend_header\n")
    with pytest.raises(OysterbenchError, match="expected vertices in a binary little-endian PLY"):
        read_ply(path)
    write_ply(path, rows, "cut")
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(OysterbenchError, match=r"expected 50 vertices of 31 bytes, got 1549 bytes"):
        read_ply(path)
