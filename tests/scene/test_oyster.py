"""Shells: closed, oyster-shaped, and each its own."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from oysterbench.core.streams import Streams
from oysterbench.scene.oyster import STATES, Shell, build_oyster, build_shell, draw_shape


def shell(k: int, state: str = "live", slenderness: float = 0.5) -> Shell:
    return build_oyster(Streams(5).generator("shell", k), state, slenderness)[1]


def solid(shell: Shell) -> trimesh.Trimesh:
    return trimesh.Trimesh(shell.mesh.vertices, shell.mesh.faces, process=False)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("k", range(5))
def test_shell_is_watertight_and_outward(state: str, k: int) -> None:
    mesh = solid(shell(k, state, 0.2 * k))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert all(part.volume > 0.002 for part in mesh.split())


def test_closed_shells_are_about_three_to_two_to_one() -> None:
    extents = np.array([shell(k, slenderness=k / 23).extent for k in range(24)])
    assert extents[:, 0] == pytest.approx(1.0, abs=0.02)
    assert np.median(extents[:, 1]) == pytest.approx(2 / 3, abs=0.1)
    assert np.median(extents[:, 2]) == pytest.approx(1 / 3, abs=0.08)
    assert extents[:, 1].std() > 0.06
    assert np.all((extents[:, 1] > 0.4) & (extents[:, 1] < 1.05))


def test_shells_of_hard_ground_are_rounder_and_more_folded_than_those_of_clumps() -> None:
    round_ones, slender_ones = (
        [draw_shape(Streams(5).generator("shape", k), slenderness) for k in range(40)] for slenderness in (0.0, 1.0)
    )
    assert np.mean([s.length for s in round_ones]) > np.mean([s.length for s in slender_ones]) + 0.15
    assert np.mean([s.fold_height for s in round_ones]) > 1.5 * np.mean([s.fold_height for s in slender_ones])


def test_left_valve_is_cupped_and_heavier_than_the_flat_right_one() -> None:
    for k in range(6):
        left, right = shell(k, "left valve"), shell(k, "right valve")
        assert left.volume > right.volume
    closed = shell(1).mesh.vertices[:, 2]
    assert -closed.min() > 1.2 * closed.max()


def test_a_box_gapes_and_a_live_shell_hardly() -> None:
    tall = [np.ptp(shell(k, "box").mesh.vertices[:, 2]) for k in range(6)]
    shut = [np.ptp(shell(k, "live").mesh.vertices[:, 2]) for k in range(6)]
    assert min(tall) > 0.5
    assert max(shut) < 0.5


def test_a_dead_shell_displaces_less_than_a_live_one_and_volume_is_the_meshs() -> None:
    closed = next(s for s in map(shell, range(9)) if len(s.mesh.faces) == len(shell(0, "left valve").mesh.faces))
    assert solid(closed).volume == pytest.approx(closed.volume, rel=1e-6)
    assert solid(shell(2, "box")).volume == pytest.approx(shell(2, "box").volume, rel=1e-6)
    assert shell(2, "box").volume < 0.7 * shell(2, "live").volume


def test_growth_runs_from_the_umbo_to_the_margin_and_the_inside_is_marked() -> None:
    mesh = shell(0).mesh
    growth = mesh.marks[:, 0]
    assert growth.min() == 0.0
    assert growth.max() == pytest.approx(1.0, abs=1e-4)
    assert np.corrcoef(growth, np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]))[0, 1] > 0.8
    assert mesh.marks[:, 1].max() == 0.0
    assert shell(0, "left valve").mesh.marks[:, 1].mean() == pytest.approx(0.5, abs=0.1)


def test_surface_has_growth_ridges() -> None:
    """Along its middle, the outside of a left valve is rougher than the same valve with its ridges taken away."""
    shape = draw_shape(Streams(5).generator("shape"), 0.3, "left valve")
    smooth = type(shape)(**{**vars(shape), "ridge_height": 0.0})
    rough = [
        np.abs(np.diff(build_shell(s, Streams(5).generator("x"), "left valve").mesh.vertices[10::36, 2], n=2)).mean()
        for s in (shape, smooth)
    ]
    assert rough[0] > 1.5 * rough[1]


def test_vertex_normals_are_unit_and_outward() -> None:
    mesh = shell(0).mesh
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0, abs=1e-5)
    reference = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    agreement = np.einsum("fi,fi->f", mesh.normals[mesh.faces].mean(axis=1), reference)
    assert np.mean(agreement > 0) > 0.98


def test_shells_differ_and_repeat_with_their_stream() -> None:
    assert np.array_equal(shell(3).mesh.vertices, shell(3).mesh.vertices)
    assert not np.array_equal(shell(3).mesh.vertices, shell(4).mesh.vertices)
