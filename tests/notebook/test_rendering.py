"""What is said while a split is rendered."""

from __future__ import annotations

import threading

from oysterbench.core.files import locked
from oysterbench.notebook import rendering
from oysterbench.simulation.generate import generate_split


def test_who_waits_for_another_process_is_told(tiny_split, tmp_path, monkeypatch):
    said: list[str] = []
    told = threading.Event()
    monkeypatch.setattr(rendering, "say", lambda text: (said.append(str(text)), told.set()))
    generate_split(tiny_split, tmp_path)
    aside = (tmp_path / "tiny-01.mcap").rename(tmp_path / "made")
    asks = threading.Thread(target=rendering.render_files, args=(tiny_split, tmp_path), daemon=True)
    with locked(tmp_path / ".lock"):
        asks.start()
        assert told.wait(20)
        aside.rename(tmp_path / "tiny-01.mcap")
    asks.join(20)
    assert said == [f"{tmp_path}: waiting for another process that renders into this folder"]
    said.clear()
    rendering.render_files(tiny_split, tmp_path)
    assert said == []
