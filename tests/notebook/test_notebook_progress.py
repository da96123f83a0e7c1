"""Progress off a terminal: few lines, each with the time left."""

from __future__ import annotations

from oysterbench.notebook.progress import plain_progress


def test_progress_off_a_terminal_tells_the_time_left(capsys, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr("oysterbench.notebook.progress.time.monotonic", lambda: now[0])
    tell = plain_progress("rendering x")
    for done in range(40, 101):  # 40 were there before
        tell(done, 100)
        now[0] += 30.0
    lines_shown = capsys.readouterr().err.splitlines()
    assert lines_shown[0] == "rendering x: 40 of 100 frames"
    assert "rendering x: 50 of 100 frames, 25 min left" in lines_shown, "half a minute for each of the 50 that are left"
    assert lines_shown[-1] == "rendering x: 100 of 100 frames"
    assert len(lines_shown) == 7


def test_progress_off_a_terminal_is_told_every_few_minutes(capsys, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr("oysterbench.notebook.progress.time.monotonic", lambda: now[0])
    tell = plain_progress("rendering x")
    for done in range(3):
        tell(done, 1000)
        now[0] += 400.0
    assert len(capsys.readouterr().err.splitlines()) == 3
