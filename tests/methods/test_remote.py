"""Methods run on a cluster: what they leave is what they leave here, also when a worker is lost or nobody waits."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

import oysterbench
from oysterbench.core.errors import OysterbenchError
from oysterbench.core.trajectory import write_tum
from oysterbench.evaluate.slam.scoring import SlamSettings
from oysterbench.methods.adapters import ExternalCommand
from oysterbench.methods.outcomes import Job
from oysterbench.methods.remote import Asked, run_asked
from oysterbench.tracks.slam import TRACK, SlamSequence
from tests.helpers.clusters import descends_from, two_workers
from tests.helpers.programs import command
from tests.helpers.track_runs import finished_of
from tests.helpers.waiting import until


@pytest.fixture(scope="module")
def cluster():
    pytest.importorskip("distributed")
    with two_workers() as found:
        yield found


@pytest.fixture
def answer(tmp_path, dive_file):
    """The true poses of the vehicle as a TUM file."""
    path = tmp_path / "work" / "answer.tum"  # programs write beside it, and cannot do so beside the results
    path.parent.mkdir()
    write_tum(path, oysterbench.open(dive_file).truth())
    return path


def run(methods, dive_file, out, **options):
    """What was finished, by the names of the methods."""
    options = {"limit_s": 60.0, "jobs": None, **options}
    done = finished_of(TRACK, [SlamSequence("hand-made", dive_file)], methods, SlamSettings(), out, **options)
    return sorted(done, key=lambda each: (each.job.adapter.name, each.job.number))


@pytest.mark.slow
def test_what_a_method_and_a_program_leave_is_the_same_as_here(cluster, dive_file, answer, tmp_path):
    methods = ["dead_reckoning", ExternalCommand(command(tmp_path, "copies", answer), "copies")]
    there = run(methods, dive_file, tmp_path / "there", scheduler=cluster.scheduler_address)
    here = run(methods, dive_file, tmp_path / "here")
    for one, other in zip(there, here, strict=True):
        assert one.failure is None
        assert one.outcome.contained == other.outcome.contained
        left, kept = one.job.folder(tmp_path / "there"), other.job.folder(tmp_path / "here")
        assert {path.name for path in left.iterdir()} == {path.name for path in kept.iterdir()}
        assert (left / "estimate.npz").read_bytes() == (kept / "estimate.npz").read_bytes()
        assert set(one.scored.record.metrics) == set(other.scored.record.metrics)


@pytest.mark.slow
def test_a_lost_worker_costs_nothing_and_what_is_finished_is_not_run_again(cluster, dive_file, answer, tmp_path):
    """The second of two runs waits; the worker that is at it is killed, and it is run by another."""
    mine = ExternalCommand(command(tmp_path, "waits", answer), "mine")
    pid, log = Path(f"{answer}.pid"), Path(f"{answer}.log")
    options = {"scheduler": cluster.scheduler_address, "runs": 2, "jobs": 1}
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(run, [mine], dive_file, tmp_path / "out", **options)
        until(lambda: pid.is_file() and pid.read_text())
        os.kill(descends_from(int(pid.read_text()), cluster), signal.SIGKILL)
        Path(f"{answer}.go").touch()
        done = running.result()
    assert [each.failure for each in done] == [None, None]
    assert log.read_text() == "run\n" * 3, "the first, the one that was lost, and that one again"
    again = run([mine], dive_file, tmp_path / "out", **options)
    assert [each.outcome for each in again] == [replace(each.outcome, earlier=True) for each in done]
    assert log.read_text() == "run\n" * 3


@pytest.mark.slow
def test_what_nobody_waits_for_any_more_is_ended(cluster, dive_file, answer, tmp_path):
    from distributed import Client

    program = ExternalCommand(command(tmp_path, "waits", answer), "mine")
    job, pid = Job(program, SlamSequence("hand-made", dive_file), 0, 600.0), Path(f"{answer}.pid")
    Path(f"{answer}.log").write_text("run\n")
    with Client(cluster.scheduler_address, set_as_default=False) as client:
        future = client.submit(run_asked, Asked(job, job.identity), dict)
        until(lambda: pid.is_file() and pid.read_text())
        future.cancel()
        until(lambda: not Path(f"/proc/{pid.read_text()}").exists())


@pytest.mark.parametrize("gone", ["sequence", "version"])
def test_a_worker_that_lacks_what_is_needed_is_named_and_no_method_has_failed(gone, dive_file, answer, tmp_path):
    program = ExternalCommand(command(tmp_path, "copies", answer), "mine")
    job = Job(program, SlamSequence("hand-made", tmp_path / "gone" if gone == "sequence" else dive_file), 0, 60.0)
    asked = Asked(job, {} if gone == "sequence" else {**job.identity, "method": "of tomorrow"})
    with pytest.raises(OysterbenchError, match=r"worker .*: .*workers need the sequence under the same path"):
        run_asked(asked, dict)
