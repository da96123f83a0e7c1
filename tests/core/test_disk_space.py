"""Whether what is written will fit, told from the first of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from oysterbench.core import disk_space as module
from oysterbench.core.disk_space import FIRST, SpaceCheck
from oysterbench.core.errors import MachineError


def filled(folder: Path, pictures: int) -> SpaceCheck:
    for k in range(pictures):
        (folder / "images").mkdir(exist_ok=True)
        (folder / "images" / f"{k}.png").write_bytes(bytes(1000))
    return SpaceCheck(folder, Path("out"))


def test_what_will_not_fit_ends_after_the_first_pictures(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "free_bytes", lambda folder: 10_000_000)
    room = filled(tmp_path, FIRST)
    room.check(FIRST, 10_000)
    room.check(FIRST + 1, 1_000_000)  # it is not looked at after each picture
    with pytest.raises(
        MachineError, match=r"^out: not enough room: this needs some 20 MB, and 10 MB are free; nothing"
    ):
        filled(tmp_path, FIRST).check(FIRST, 20_000)


def test_a_folder_that_grows_faster_than_its_first_pictures_is_looked_at_again(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "free_bytes", lambda folder: 10_000_000)
    room = filled(tmp_path, FIRST)
    room.check(FIRST, 1000)
    (tmp_path / "large").write_bytes(bytes(2_000_000))
    with pytest.raises(MachineError, match="not enough room"):
        room.check(2 * FIRST, 1000)


def test_what_is_known_beforehand_is_refused_before_the_first_byte(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "free_bytes", lambda folder: 1000)
    SpaceCheck(tmp_path, Path("out")).need(1000)
    with pytest.raises(MachineError, match="choose another place with --out"):
        SpaceCheck(tmp_path, Path("out")).need(1001)
