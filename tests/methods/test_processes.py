"""Commands under their supervisor: whatever they do to it, they end in time and report nothing of themselves."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from oysterbench.core.errors import MachineError
from oysterbench.methods import processes, sharing
from oysterbench.methods.processes import Ended, Processes, secrets
from oysterbench.methods.sandbox import can_hide
from oysterbench.methods.sharing import Sharing

hides = pytest.mark.skipif(not can_hide(), reason="needs Landlock: Linux 5.13 or later")

STOPS = """
import os, signal, sys, time
supervisor = os.getppid()
os.kill(supervisor, signal.SIGSTOP)
time.sleep(float(sys.argv[1]))
if len(sys.argv) > 2 and os.fork() == 0:
    os.setsid()
    time.sleep(0.1)
    os.kill(supervisor, signal.SIGCONT)
"""
FORGED = {"status": 0, "signal": None, "timed_out": False, "stopped": False, "wall_s": 0.001, "cpu_s": 0.001}


def run(folder: Path, code: str, *args: object, limit_s: float = 30.0, **options: object) -> Ended:
    folder.mkdir(exist_ok=True)
    command = [sys.executable, "-I", "-S", "-c", code, *map(str, args)]
    return Processes().run(command, limit_s, folder, **options)  # type: ignore[arg-type]


def test_a_command_that_stopped_its_supervisor_until_it_was_done_has_failed_at_its_limit(tmp_path):
    assert run(tmp_path, STOPS, 0.8, "continues", limit_s=0.4).failure == "time limit of 0.4 s reached: killed"


def test_a_supervisor_that_was_stopped_is_not_waited_for_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "KILLING_S", 0.2)
    monkeypatch.setattr(processes, "MARGIN_S", 0.2)
    monkeypatch.setattr(processes, "CONTINUED_S", 30.0)
    assert run(tmp_path, STOPS, 60.0, limit_s=0.2).failure == "time limit of 0.2 s reached: killed"


@pytest.mark.parametrize("hidden", [False, True])
def test_commands_that_share_a_machine_have_a_share_of_its_cores_unless_the_user_says_otherwise(
    tmp_path, monkeypatch, hidden
):
    prints = [sys.executable, "-I", "-S", "-c", "import os; print(os.environ.get('OMP_NUM_THREADS'))"]
    hides = {"hidden": [tmp_path / "truth"]} if hidden else {}

    def printed(cores: int | None) -> str:
        Processes().run(prints, 30.0, tmp_path, cores=cores, **hides)
        return (tmp_path / "stdout.txt").read_text().strip()

    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert printed(3) == "3"
    assert printed(None) == "None"
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    assert printed(3) == "7"


def job(method: str) -> Any:
    return SimpleNamespace(adapter=SimpleNamespace(name=method))


@pytest.mark.parametrize(
    ("workers", "waiting", "cores"),
    [(16, 15, 8), (16, 0, None), (1, 15, None), (2, 15, 8)],
)
def test_cores_are_shared_by_the_runs_that_fit_into_memory_not_by_all_that_wait(monkeypatch, workers, waiting, cores):
    """Two of these networks fit at a time: each has half of the cores; and where one is alone, it has all."""
    monkeypatch.setattr(sharing, "default_workers", lambda: 16)
    shared = Sharing(workers, {"net": 7 * 2**30}, 17 * 2**30)
    first, *others = [job("net") for _ in range(waiting + 1)]
    assert shared.fits(first, [])
    assert shared.cores(first, [], others) == cores
    if others:
        assert shared.fits(others[0], [first]) == (workers > 1)
        assert not shared.fits(others[0], [first, others[1]])


def test_the_last_of_many_runs_shares_cores_with_those_that_still_run(monkeypatch):
    monkeypatch.setattr(sharing, "default_workers", lambda: 16)
    shared = Sharing(8, {}, 2**40)
    jobs = [job("light") for _ in range(20)]
    assert shared.cores(jobs[0], [], jobs[1:]) == 2
    assert shared.cores(jobs[19], jobs[16:19], []) == 4
    assert shared.cores(jobs[19], [], []) is None
    shared.learn(jobs[0], SimpleNamespace(process={"peak_bytes": 2**40}))
    assert shared.cores(jobs[0], [], jobs[1:]) is None


def test_a_report_is_not_forged_by_the_command(tmp_path):
    forges = "import os, sys; open('process.json', 'w').write(sys.argv[1]); os.kill(os.getppid(), 9)"
    forged = json.dumps({**FORGED, "peak_bytes": 4096, "left_behind": 0, "error": None})
    with pytest.raises(MachineError, match=r"the supervisor of .* was killed"):
        run(tmp_path, f"import os; os.chdir({str(tmp_path)!r}); {forges}", forged)
    opens = "import os; print(os.listdir('/proc/self/fd'))"
    run(tmp_path, opens)
    assert len(json.loads((tmp_path / "stdout.txt").read_text().replace("'", '"'))) == 4, "its streams and the listing"


@pytest.mark.parametrize(
    ("kills", "memory", "why"),
    [
        ([4, 4], 2**60, "by itself or from outside: memory was not short"),
        ([4, 5], 2**60, "out of memory?"),
        ([4, 4], 2**20, "out of memory?"),
    ],
)
def test_only_a_kill_while_memory_was_short_is_put_down_to_that(kills, memory, why, tmp_path, monkeypatch):
    known = f"oom_kills, memory_bytes = iter({kills}).__next__, lambda: {memory}"
    source = processes.SUPERVISOR.read_text().replace("if __name__", f"{known}\n\nif __name__")
    (tmp_path / "supervise.py").write_text(source)
    monkeypatch.setattr(processes, "SUPERVISOR", tmp_path / "supervise.py")
    with pytest.raises(MachineError) as killed:
        run(tmp_path / "work", "import os; os.kill(os.getpid(), 9)")
    assert str(killed.value) == f"killed by SIGKILL ({why})"


@hides
def test_a_contained_command_cannot_change_the_code_that_contains_the_next(tmp_path):
    places = [processes.__file__, Path(sys.prefix) / "new", Path.home() / "new", tmp_path / "results" / "new"]
    (tmp_path / "results").mkdir()
    (tmp_path / "truth").mkdir()
    code = """
import sys
for path in sys.argv[1:]:
    try:
        open(path, 'a')
        print('changed', path)
    except OSError as error:
        print(error.strerror)
"""
    ended = run(tmp_path / "run", code, *places, hidden=[tmp_path / "truth"], fixed=[tmp_path / "results"])
    assert ended.failure is None
    assert (tmp_path / "run" / "stdout.txt").read_text().splitlines() == ["Permission denied"] * len(places)


@hides
def test_a_contained_command_writes_to_its_folder_temporary_files_shared_memory_and_caches(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "truth").mkdir()
    code = """
import os, sys, tempfile
for folder in (sys.argv[1], tempfile.gettempdir(), '/dev/shm', os.environ['XDG_CACHE_HOME'] + '/torch'):
    with tempfile.NamedTemporaryFile(dir=folder) as file:
        file.write(b'x')
print(tempfile.gettempdir())
"""
    ended = run(tmp_path / "run", code, tmp_path / "run", hidden=[tmp_path / "truth"])
    assert ended.failure is None
    temporary = Path((tmp_path / "run" / "stdout.txt").read_text().strip())
    assert temporary.is_relative_to(tmp_path / "run")
    assert not temporary.exists()


def test_the_file_of_the_salt_is_as_secret_as_the_splits(monkeypatch, tmp_path):
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path))
    monkeypatch.setenv("OYSTERBENCH_SALT_FILE", str(tmp_path / "salt"))
    assert secrets() == (tmp_path / "splits", tmp_path / "salt")
    monkeypatch.delenv("OYSTERBENCH_SALT_FILE")
    assert secrets() == (tmp_path / "splits",)


@hides
def test_who_writes_where_he_may_not_is_told_where_he_may(tmp_path):
    (tmp_path / "hidden").mkdir()
    place = Path.home() / "never.txt"
    failure = run(tmp_path / "own", f"open({str(place)!r}, 'w')", hidden=[tmp_path / "hidden"]).failure
    assert failure is not None
    assert not place.exists()
    assert failure.endswith(
        "; it can write only to the folder of {out}, to temporary folders such as TMPDIR, and to /dev/shm"
    )
