"""An oyster as a file: read back by trimesh it is the same solid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from oysterbench.core.errors import RecipeError
from oysterbench.scene.export import SUFFIXES, export_oyster
from oysterbench.scene.oyster import STATES


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_oyster_comes_back_with_its_size_and_volume(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"oyster{suffix}"
    told = export_oyster(11, path, size_mm=90.0, state="left valve")
    back = trimesh.load_mesh(path)
    back.merge_vertices(merge_norm=True, merge_tex=True)
    assert told["watertight"]
    assert back.is_watertight
    assert len(back.faces) == told["triangles"]
    assert told["height_m"] == pytest.approx(0.09)
    assert back.extents == pytest.approx([told["height_m"], told["length_m"], told["width_m"]], rel=1e-4)
    assert back.volume == pytest.approx(told["volume_m3"], rel=1e-3)


@pytest.mark.parametrize("state", STATES)
def test_every_state_is_watertight_and_of_an_oysters_volume(tmp_path: Path, state: str) -> None:
    told = export_oyster(3, tmp_path / "oyster.ply", size_mm=100.0, state=state)
    assert told["watertight"]
    assert 5e-6 < told["volume_m3"] < 2e-4  # 5 to 200 cm^3


def test_vertex_colours_are_written(tmp_path: Path) -> None:
    export_oyster(11, tmp_path / "oyster.glb")
    visual = trimesh.load_mesh(tmp_path / "oyster.glb").visual
    assert isinstance(visual, trimesh.visual.ColorVisuals)
    colours = visual.vertex_colors
    assert np.ptp(colours[:, 0]) > 40


def test_same_seed_gives_the_same_bytes_and_another_does_not(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.ply", "b.ply", "c.ply")]
    for path, seed in zip(paths, (5, 5, 6), strict=True):
        export_oyster(seed, path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert paths[0].read_bytes() != paths[2].read_bytes()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path": "oyster.txt"}, r"oyster\.txt: expected a file name that ends in \.glb.*got '\.txt'"),
        ({"path": "oyster"}, "ends in .*got 'none'"),
        ({"seed": -1}, "seed: expected a whole number from 0.*got -1"),
        ({"seed": 1.5}, "seed: expected a whole number.*got 1.5"),
        ({"size_mm": 10.0}, "size_mm: expected 25 to 172.*got 10"),
        ({"size_mm": float("nan")}, "size_mm: expected 25 to 172.*got nan"),
        ({"state": "fried"}, "state: expected one of live, box.*got 'fried'"),
    ],
)
def test_a_bad_value_is_named_and_nothing_is_written(tmp_path: Path, changes, message: str) -> None:
    values = {"seed": 1, "path": "oyster.glb", **changes}
    with pytest.raises(RecipeError, match=message) as caught:
        export_oyster(**{**values, "path": tmp_path / values["path"]})
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
