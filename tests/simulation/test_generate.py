"""Generation: the same bytes from any number of workers, after any interruption."""

from __future__ import annotations

import errno
import hashlib
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MachineError, OysterbenchError, SequenceError
from oysterbench.core.locks import locked
from oysterbench.recipe import count, parse_split
from oysterbench.sequence.cut import cut_to, match_topics
from oysterbench.sequence.truth import rig_topics
from oysterbench.simulation import generate, scheduling
from oysterbench.simulation.assembly import assemble
from oysterbench.simulation.generate import digest, generate_split, split_folder
from oysterbench.simulation.jobs import plan
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT, make_split
from tests.helpers.waiting import until


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """A split whose only dive has two cameras with a video link, and its file."""
    camera = TINY_RIG[TINY_RIG.index("[[camera]]") :]
    rig = TINY_RIG.replace("cam_front", "cam_left") + camera.replace("cam_front", "cam_right") + "[pressure]\n"
    recipe = TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 1.0\nrig = { camera = { video_mbit_s = 0.1 } }")
    split = parse_split(recipe, "tiny.toml", rig_source=rig)
    return split, generate_split(split, tmp_path_factory.mktemp("dive"))["tiny-01"]


def sha256(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.slow
def test_two_workers_give_the_bytes_of_one(tiny_split, tiny_file, tmp_path):
    seen = []
    files = generate_split(tiny_split, tmp_path, workers=2, progress=lambda done, total: seen.append((done, total)))
    assert sha256(files["tiny-01"]) == sha256(tiny_file)
    assert seen[0] == (0, 25)
    assert seen[-1] == (25, 25)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        ".lock",
        "costs.json",
        "tiny-01.mcap",
    ], "nothing else is left behind"


def test_what_is_stopped_while_it_is_put_together_keeps_its_parts(tiny_split, tiny_file, tmp_path, monkeypatch):
    stopped = threading.Event()
    stopped.set()
    with monkeypatch.context() as patch:
        patch.setattr(generate, "assemble", lambda *given: assemble(*given[:-1], stopped))
        with pytest.raises(OysterbenchError, match=r"tiny-01\.mcap: stopped while .* its parts are kept"):
            generate_split(tiny_split, tmp_path)
    assert not (tmp_path / "tiny-01.mcap").exists()
    monkeypatch.setattr(
        generate, "make_timed_part", lambda *given, **more: pytest.fail("rendered again")
    )  # nothing is left to be rendered
    assert sha256(generate_split(tiny_split, tmp_path)["tiny-01"]) == sha256(tiny_file)


@pytest.mark.parametrize(
    "damage", [lambda data: data[: len(data) // 2], lambda data: data.replace(b"cam_front", b"cam_fr0nt")]
)
def test_a_damaged_part_is_rendered_again_and_said(tiny_split, tiny_file, tmp_path, damage):
    class Enough(Exception):
        pass

    def stop_after_two(done, total):
        if done > 1:
            raise Enough

    with pytest.raises(Enough):
        generate_split(tiny_split, tmp_path, progress=stop_after_two)
    part, *_ = sorted(tmp_path.glob(".parts/*/cam_front-*.part"))
    part.write_bytes(damage(part.read_bytes()))
    said = []
    assert sha256(generate_split(tiny_split, tmp_path, tell=said.append)["tiny-01"]) == sha256(tiny_file)
    assert said == [f"{part.parent}: truncated or damaged, rendered again: {part.name}"]


def test_what_is_there_is_not_rendered_again(tiny_split, tiny_file):
    before = tiny_file.stat().st_mtime_ns
    seen = []
    generate_split(tiny_split, tiny_file.parent, progress=lambda done, total: seen.append(done))
    assert seen == []
    assert tiny_file.stat().st_mtime_ns == before


def test_what_is_there_does_not_wait_for_what_is_being_rendered(tiny_split, tiny_file):
    """As when one sequence of a split is rendered, and a method runs on another."""
    found: list[dict[str, Path]] = []
    ask = threading.Thread(target=lambda: found.append(generate_split(tiny_split, tiny_file.parent)), daemon=True)
    with locked(tiny_file.parent / ".lock"):
        ask.start()
        ask.join(30)
        assert found == [{"tiny-01": tiny_file}]


RENDER = """
import sys
from pathlib import Path
from oysterbench.simulation.generate import generate_split
from oysterbench.recipe import parse_split
split = parse_split(Path(sys.argv[1]).read_text(), "tiny.toml", rig_source=Path(sys.argv[2]).read_text())
if __name__ == "__main__":
    generate_split(split, Path(sys.argv[3]), workers=int(sys.argv[4]))
"""


@pytest.mark.parametrize("kills", [(2,), (1, 3, 5)])
@pytest.mark.slow
def test_a_render_killed_again_and_again_ends_in_the_same_bytes(tiny_file, tmp_path, kills):
    script, recipe, rig, out = (tmp_path / name for name in ("render.py", "tiny.toml", "rig.toml", "out"))
    script.write_text(RENDER)
    recipe.write_text(TINY_SPLIT)
    rig.write_text(TINY_RIG)
    command = [sys.executable, script, recipe, rig, out, "2"]
    finished = out / "tiny-01.mcap"
    parts_seen = 0
    for wanted in kills:
        process = subprocess.Popen(command, start_new_session=True)
        until(
            lambda process=process, wanted=wanted: (
                process.poll() is not None or finished.exists() or len([*out.glob(".parts/*/*.part")]) >= wanted
            )
        )
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        assert not finished.exists() or sha256(finished) == sha256(tiny_file)
        parts = len(list(out.glob(".parts/*/*.part")))
        assert parts >= parts_seen or finished.exists(), "what was finished is kept"
        parts_seen = parts
    subprocess.run(command, check=True)
    assert sha256(finished) == sha256(tiny_file)
    assert not (out / ".parts").exists()


@pytest.mark.slow
def test_workers_leave_with_a_parent_that_is_killed(tmp_path):
    script, recipe, rig, out = (tmp_path / name for name in ("render.py", "tiny.toml", "rig.toml", "out"))
    script.write_text(RENDER)
    recipe.write_text(TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 600.0"))
    rig.write_text(TINY_RIG)
    process = subprocess.Popen([sys.executable, script, recipe, rig, out, "2"], start_new_session=True)
    try:
        until(lambda: list(out.glob(".parts/*/*.part")), process)
        process.kill()  # the parent alone: its workers notice
        process.wait()
        until(lambda: not members(process.pid))
    finally:
        if members(process.pid):
            os.killpg(process.pid, signal.SIGKILL)


def members(group):
    """Live processes of a process group, by /proc."""
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                fields = Path(f"/proc/{entry}/stat").read_text().rsplit(")", 1)[1].split()
            except OSError:
                continue
            if int(fields[2]) == group and fields[0] != "Z":
                found.append(int(entry))
    return found


PLAIN_PROCESSOR = {
    "NPY_DISABLE_CPU_FEATURES": " ".join(name for name in __cpu_dispatch__ if __cpu_features__[name]),
    "OPENBLAS_CORETYPE": "Nehalem",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-AVX512F,-FMA",
}
"""Makes NumPy, OpenBLAS and the C library compute as on an old processor."""


def test_another_processor_gives_the_same_bytes(tiny_file, tmp_path):
    script, recipe, rig, out = (tmp_path / name for name in ("render.py", "tiny.toml", "rig.toml", "out"))
    script.write_text(RENDER)
    recipe.write_text(TINY_SPLIT)
    rig.write_text(TINY_RIG)
    command = [sys.executable, script, recipe, rig, out, "1"]
    subprocess.run(command, env={**os.environ, **PLAIN_PROCESSOR}, check=True)
    assert sha256(out / "tiny-01.mcap") == sha256(tiny_file)


def test_some_topics_are_the_file_that_is_cut_from_the_complete_one(dive, tmp_path):
    """By the camera that makes them alone; and no complete file is taken for one, nor one for a complete file."""
    split, whole = dive
    for wanted, jobs in ((["/cam_left/*", "/imu", "/truth/*"], 11), (["/tf_static", "/pressure"], 1)):
        assert len(plan(split, split.sequence[0], wanted)) == jobs
        made = generate_split(split, tmp_path / wanted[0].strip("/*"), topics=wanted)["tiny-01"]
        cut_to(tmp_path / "cut.mcap", whole, match_topics(rig_topics(split.rig), wanted, "tiny-01"))
        assert made.read_bytes() == (tmp_path / "cut.mcap").read_bytes()
    with pytest.raises(SequenceError, match=r"has 2 topics, expected \d+: it was made with other --topics"):
        generate_split(split, made.parent)
    with pytest.raises(SequenceError, match="it was made with other --topics; it was left unchanged"):
        generate_split(split, whole.parent, topics=["/imu"])
    with pytest.raises(SequenceError, match="tiny-01: no topic matches '/cam_front/image'; its topics: /cam_left/"):
        generate_split(split, tmp_path / "none", topics=["/cam_front/image"])


def test_without_room_nothing_is_rendered(tiny_split, tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "free_bytes", lambda folder: 10_000)
    with pytest.raises(MachineError, match=r"not enough room: rendering needs some .* MB, and 0 MB are free; nothing"):
        generate_split(tiny_split, tmp_path / "out")
    assert not list((tmp_path / "out").rglob("*.part"))


def test_a_disk_that_fills_up_is_named(tmp_path, monkeypatch):
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as raised:
        write_atomically(tmp_path / "results.json", b"{}")
    assert raised.value.filename == str(tmp_path / "results.json")
    assert list(tmp_path.iterdir()) == []


def test_what_the_system_refuses_while_it_renders_is_told_by_the_folder_that_was_asked_for(
    tiny_split, tmp_path, monkeypatch
):
    def full(split, missing, folder, *rest):
        part = folder / ".parts" / "tiny-01" / "0.part"
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(part))

    monkeypatch.setattr(generate, "_render", full)
    with pytest.raises(OSError, match="No space left") as raised:
        generate_split(tiny_split, tmp_path / "out")
    assert raised.value.filename == str(tmp_path / "out")


def test_a_file_of_another_recipe_is_refused_and_left_alone(tiny_file, tmp_path):
    other = make_split(TINY_SPLIT.replace("seed = 5", "seed = 6"))
    copy = tmp_path / "tiny-01.mcap"
    copy.write_bytes(tiny_file.read_bytes())
    with pytest.raises(SequenceError, match="made by another recipe of tiny"):
        generate_split(other, tmp_path)
    assert sha256(copy) == sha256(tiny_file)


def test_a_sequence_that_is_named_twice_is_rendered_once(tiny_split, tmp_path, monkeypatch):
    make, made = generate.make_timed_part, []

    def noted(split, job, **more):
        made.append(job)
        return make(split, job, **more)

    monkeypatch.setattr(generate, "make_timed_part", noted)
    files = generate_split(tiny_split, tmp_path, names=["tiny-01", "tiny-01"], topics=["/imu"])
    assert [*files] == ["tiny-01"]
    assert len(made) == 1
    assert generate.is_whole(files["tiny-01"])
    assert not (tmp_path / ".parts").exists()


def test_the_salt_decides_the_bytes(tiny_split):
    assert digest(tiny_split, b"a") != digest(tiny_split, b"b")
    assert split_folder(tiny_split, b"a") != split_folder(tiny_split)


def test_every_frame_is_in_one_job(tiny_split):
    recipe = tiny_split.sequence[0]
    frames = [job.frame for job in plan(tiny_split, recipe) if job.source]
    assert frames == list(range(25))
    assert sum(job.frames for job in plan(tiny_split, recipe)) == 25


@pytest.mark.parametrize(
    ("duration", "rate", "expected"), [(2.5, 10.0, 25), (1.0, 3.0, 3), (0.3, 10.0, 3), (0.31, 10.0, 4)]
)
def test_samples_lie_below_the_duration(duration, rate, expected):
    assert count(duration, rate) == expected
    assert (expected - 1) / rate < duration


def test_sigterm_while_processes_work_is_an_error_like_any_other():
    before = signal.getsignal(signal.SIGTERM)

    def terminated():
        with scheduling._ended_in_order():
            assert signal.getsignal(signal.SIGTERM) not in (signal.SIG_DFL, signal.SIG_IGN)
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(scheduling.Terminated, match="the same command resumes from there"):
        terminated()
    assert signal.getsignal(signal.SIGTERM) == before
    assert scheduling.Terminated.exit_code == 143
