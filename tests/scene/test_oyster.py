"""Shells: closed, oyster-shaped, and each its own."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from oysterbench.scene.oyster import build_shell, draw_form
from oysterbench.streams import Streams


def shell(k: int):
    generator = Streams(5).generator("shell", k)
    return build_shell(draw_form(generator), generator)


@pytest.mark.parametrize("k", range(12))
def test_shell_is_watertight_and_outward(k: int) -> None:
    mesh = trimesh.Trimesh(shell(k).vertices, shell(k).faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.005


@pytest.mark.parametrize("k", range(12))
def test_shell_has_unit_height_and_an_oysters_proportions(k: int) -> None:
    height, length, width = np.ptp(shell(k).vertices, axis=0)
    assert height == pytest.approx(1.0, abs=0.03)
    assert 0.4 < length < 1.0
    assert 0.1 < width < 0.5


def test_vertex_normals_are_unit_and_outward() -> None:
    mesh = shell(0)
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0, abs=1e-5)
    reference = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    agreement = np.einsum("fi,fi->f", mesh.normals[mesh.faces].mean(axis=1), reference)
    assert np.mean(agreement > 0) > 0.99


def test_shells_differ_and_repeat_with_their_stream() -> None:
    assert np.array_equal(shell(3).vertices, shell(3).vertices)
    assert not np.array_equal(shell(3).vertices, shell(4).vertices)
