"""Tiles wait in a file that nobody has to clear up."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest

from oysterbench.core.errors import LabelError
from oysterbench.mapping import Seen
from oysterbench.mapping.cover import tile_of
from oysterbench.mapping.tiles import Tiles
from tests.helpers.flat_reef import LANE, FlatReef, scattered
from tests.mapping.test_cover import RASTER, picture
from tests.mapping.test_density_map import map_of


@pytest.fixture
def opened(monkeypatch):
    """Temporary files that were opened."""
    files, original = [], tempfile.TemporaryFile

    def noted(**options):
        files.append(original(**options))
        return files[-1]

    monkeypatch.setattr(tempfile, "TemporaryFile", noted)
    return files


def test_tiles_come_back_as_they_went_and_again():
    made = [tile_of(RASTER, *picture(seed, n=n)) for seed, n in ((0, 20_000), (1, 0), (2, 1), (3, 7))]
    with Tiles() as tiles:
        for tile in made:
            tiles.add(tile)
        for _ in range(2):
            for found, tile in zip(tiles, made, strict=True):
                assert found.raster == tile.raster
                for name in ("seen", "distances_m", "colours"):
                    ours, theirs = getattr(found, name), getattr(tile, name)
                    assert ours.dtype == theirs.dtype
                    assert np.array_equal(ours, theirs)


def test_their_file_has_no_name_by_which_it_could_be_left_behind(opened, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Tiles() as tiles:
        tiles.add(tile_of(RASTER, *picture(0)))
        assert os.fstat(opened[0].fileno()).st_nlink == 0
        assert list(tmp_path.iterdir()) == []
    assert opened[0].closed


@pytest.mark.parametrize("ending", [KeyboardInterrupt, LabelError])
def test_it_is_gone_when_a_map_is_broken_off(opened, ending):
    reef = FlatReef(LANE[:2], scattered(-1.0, 1.5))

    def seen():
        yield Seen(int(reef.stamps[0]), "cam", reef.numbers(0))
        raise ending

    with pytest.raises(ending):
        map_of(reef, seen=seen)
    assert [file.closed for file in opened] == [True]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_is_named(monkeypatch):
    tile = tile_of(RASTER, *picture(0))
    with open("/dev/full", "r+b") as full:
        monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: full)
        with Tiles() as tiles, pytest.raises(OSError, match="No space left") as caught:
            tiles.add(tile)
    assert caught.value.filename == tempfile.gettempdir()
