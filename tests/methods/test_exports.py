"""Exports that are kept: made once for all runs, out of reach of whoever would spoil them, and bounded."""

from __future__ import annotations

import os
import stat
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.core.trajectory import write_tum
from oysterbench.evaluate.slam.scoring import SlamSettings
from oysterbench.methods import exports, inputs, processes
from oysterbench.methods.adapters import ExternalCommand
from oysterbench.methods.exports import Exports
from oysterbench.methods.sandbox import can_hide
from oysterbench.tracks.slam import TRACK, SlamSequence
from tests.helpers.programs import PROGRAMS, command
from tests.helpers.track_runs import finished_of

SPOILS = (
    "import shutil, pathlib\n"
    "for file in sorted(pathlib.Path(argv[1]).rglob('*.csv')):\n"
    "    try: file.write_text('spoilt')\n"
    "    except OSError as error: print(error, flush=True)\n"
    "shutil.copy(argv[0], argv[2])"
)

LOOKS = (
    "import shutil, pathlib\n"
    "try: print(list(pathlib.Path(argv[2]).parent.parent.iterdir()))\n"
    "except OSError as error: print(error)\n"
    "shutil.copy(argv[0], argv[2])"
)


@pytest.fixture
def run(dive_file, tmp_path, monkeypatch):
    """A program on a folder in EuRoC layout, results in `out`: what was finished, and how many exports were made."""
    work = tmp_path / "work"
    work.mkdir()
    write_tum(work / "answer.tum", oysterbench.open(dive_file).truth())
    made = []
    original = processes.Processes.run

    def spy(self, words, *rest, **options):
        made.append("oysterbench.methods.interfaces.slam" in words)
        return original(self, words, *rest, **options)

    monkeypatch.setattr(processes.Processes, "run", spy)
    monkeypatch.setitem(PROGRAMS, "spoils", SPOILS)

    def call(out, program="copies", split=None, **options):
        made.clear()
        adapter = ExternalCommand(command(work, program, work / "answer.tum", "euroc"), program)
        sequence = SlamSequence("hand-made", dive_file, split)
        options = {"exports": tmp_path / "kept" / "exports", "limit_s": 60.0, **options}
        done = finished_of(TRACK, [sequence], [adapter], SlamSettings(), tmp_path / out, **options)
        return done, made.count(True)

    return call


def kept(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "kept" / "exports").glob("*/hand-made"))


def test_an_export_is_made_once_for_all_runs_and_folders_of_results(run, tmp_path):
    said: list[str] = []
    done, made = run("one", runs=3, jobs=2, announce=said.append)
    assert [each.failure for each in done] == [None] * 3
    assert made == 1
    assert said.count("writing hand-made as euroc, kept for other runs") == 1
    assert run("two")[1] == 0
    (place,) = kept(tmp_path)
    assert (place / "mav0" / "imu0" / "data.csv").is_file()
    assert stat.S_IMODE((tmp_path / "kept" / "exports").stat().st_mode) == 0o700


@pytest.mark.skipif(not can_hide(), reason="the kernel has no Landlock")
def test_a_program_reads_its_export_and_cannot_write_to_it(run, tmp_path):
    (done,), _ = run("one", "spoils")
    assert done.failure is None
    said = (done.job.folder(tmp_path / "one") / "stdout.txt").read_text()
    assert said.count("Permission denied") == 3
    assert all(path.read_text() != "spoilt" for path in kept(tmp_path)[0].rglob("*.csv"))
    assert run("two")[1] == 0


def test_where_the_kernel_hides_nothing_a_program_is_given_a_copy(run, tmp_path, monkeypatch):
    for module in (inputs, processes):
        monkeypatch.setattr(module, "can_hide", lambda: False)
    (done,), _ = run("one", "spoils")
    assert done.failure is None
    assert not (done.job.folder(tmp_path / "one") / "stdout.txt").read_text()
    assert "exports" not in " ".join(done.outcome.command)
    assert all(path.read_text() != "spoilt" for path in kept(tmp_path)[0].rglob("*.csv"))


def test_what_was_changed_by_anybody_is_made_anew(run, tmp_path):
    run("one")
    (file,) = kept(tmp_path)[0].glob("mav0/imu0/data.csv")
    before = file.read_bytes()
    file.write_text("spoilt")
    assert run("two")[1] == 1
    assert file.read_bytes() == before


def test_nothing_is_kept_of_a_hidden_split_nor_where_nothing_shall_be(run, tmp_path, monkeypatch, tiny_split):
    hidden = replace(tiny_split, hidden=True, sequence=(replace(tiny_split.sequence[0], name="hand-made"),))
    (done,), made = run("one", split=hidden)
    assert done.failure is None
    assert made == 1
    monkeypatch.setenv(exports.SETTING, "0")
    assert run("two")[1] == 1
    assert kept(tmp_path) == []


@pytest.mark.skipif(not can_hide(), reason="the kernel has no Landlock")
def test_an_input_that_is_not_kept_is_not_written_to_either_nor_seen_by_other_runs(
    run, tmp_path, monkeypatch, tiny_split
):
    hidden = replace(tiny_split, hidden=True, sequence=(replace(tiny_split.sequence[0], name="hand-made"),))
    monkeypatch.setitem(PROGRAMS, "looks", LOOKS)
    for program, said in (("spoils", ["Permission denied"] * 3), ("looks", ["Permission denied"])):
        (done,), _ = run("one", program, split=hidden)
        assert done.failure is None
        text = (done.job.folder(tmp_path / "one") / "stdout.txt").read_text()
        assert [line.partition("] ")[2].partition(":")[0] for line in text.splitlines()] == said


def test_a_bound_that_is_no_number_is_named(monkeypatch):
    monkeypatch.setenv(exports.SETTING, "much")
    with pytest.raises(MethodError, match=r"OYSTERBENCH_EXPORTS_GB: expected the maximum size .* got 'much'"):
        exports.most_gigabytes()


# The folder itself


def write(size: int):
    return lambda folder: (folder / "file").write_bytes(bytes(size))


def use(store: Exports, *keys: str, size: int = 10) -> None:
    for key in keys:
        with store.hold(key, write(size)):
            pass


def names(store: Exports) -> set[str]:
    return {path.name for path in store.folder.iterdir()} - {"locks"}


def test_the_longest_unused_go_first_where_all_are_too_large_and_none_that_is_used(tmp_path):
    store = Exports(tmp_path, most_bytes=25)
    use(store, "a", "b", "c")
    os.utime(tmp_path / "a" / exports.MADE, (1e9 + 2, time.time() - 2))
    with store.hold("b", write(10)):
        os.utime(tmp_path / "b" / exports.MADE, (1e9, time.time() - 9))
        store.tidy()
        assert names(store) == {"b", "c"}
        Exports(tmp_path, most_bytes=0).tidy()
        assert names(store) == {"b"}


def test_what_was_not_used_for_long_is_taken_away_sooner_where_other_code_wrote_it_anew(tmp_path):
    store = Exports(tmp_path, most_bytes=1e9)
    ages = {"a-1": exports.MOST_DAYS + 1, "b-1": exports.MOST_DAYS - 1, "b-2": 0, "c-1": 0.5, "c-2": 0, "d-1": 29}
    for key, days in ages.items():
        use(store, key)
        used = time.time() - days * 86400
        os.utime(tmp_path / key / exports.MADE, (used, used))
    store.tidy()
    assert names(store) == {"b-2", "c-1", "c-2", "d-1"}


def test_an_export_that_fails_leaves_nothing_and_one_that_was_killed_is_made_anew(tmp_path):
    store = Exports(tmp_path)

    def fail(folder):
        write(10)(folder)
        raise MethodError("no room")

    with pytest.raises(MethodError, match="no room"), store.hold("a", fail):
        pass
    assert names(store) == set()
    (tmp_path / ".a").mkdir()
    (tmp_path / ".a" / "half").touch()
    use(store, "a")
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"file", exports.MADE}
    (tmp_path / ".b").mkdir()
    store.tidy()
    assert names(store) == {"a"}


def test_who_comes_while_it_is_made_waits_for_it_or_leaves(tmp_path, monkeypatch):
    monkeypatch.setattr(exports, "LOOK_S", 0.01)
    store, made, looked = Exports(tmp_path), [], []

    def make(folder):
        made.append(folder)
        while not looked:  # until the other one waits
            time.sleep(0.001)
        write(10)(folder)

    def hold(_):
        with store.hold("a", make, lambda: looked.append(True)) as folder:
            return (folder / "file").read_bytes()

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(hold, range(2))) == [bytes(10)] * 2
    assert len(made) == 1

    def leave():
        raise KeyboardInterrupt

    (tmp_path / "a" / "file").unlink()  # whoever comes has to make it, and another one holds it
    with store._lock_file("a") as lock:
        exports._wait(lock, exports.fcntl.LOCK_SH, leave)
        with pytest.raises(KeyboardInterrupt), store.hold("a", write(10), leave):
            pass
