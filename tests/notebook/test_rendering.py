"""What is said while a split is rendered."""

from __future__ import annotations

import threading

from oysterbench.core.locks import locked
from oysterbench.notebook import rendering
from oysterbench.simulation import cost
from oysterbench.simulation.generate import PARTS, digest, generate_split
from oysterbench.simulation.jobs import plan


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


def test_what_an_interrupted_render_will_still_take_is_said(tiny_split, tmp_path, monkeypatch):
    said: list[str] = []
    monkeypatch.setattr(rendering, "say", said.append)
    monkeypatch.setattr(cost, "estimated", lambda split, sequence, workers, topics, taken: 1200.0)
    monkeypatch.setattr("oysterbench.simulation.generate.generate_split", lambda *given: {})
    rendering.render_files(tiny_split, tmp_path, workers=2)
    jobs = plan(tiny_split, tiny_split.sequence[0])
    parts = tmp_path / PARTS / f"tiny-01-{digest(tiny_split)[:12]}"
    parts.mkdir(parents=True)
    for job in jobs[: len(jobs) // 2]:
        (parts / job.part).touch()
    rendering.render_files(tiny_split, tmp_path, workers=2)
    assert said == [
        "rendering tiny: tiny-01 will take about 10 min on 2 workers",
        "rendering tiny: tiny-01 will take about 5 min on 2 workers",
    ]
