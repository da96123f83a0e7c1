"""Generation on a Dask cluster: the bytes of a local render, also when a worker is lost."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import pytest

from oysterbench.core.cluster import run_on_cluster
from oysterbench.core.errors import OysterbenchError
from oysterbench.simulation.cost import COSTS
from oysterbench.simulation.generate import PROGRAM, generate_split, make_part
from oysterbench.simulation.jobs import Job
from oysterbench.simulation.salt import Salt
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

distributed = pytest.importorskip("distributed")

CLUSTER = """
import os, signal, sys
from pathlib import Path
from distributed import LocalCluster
from oysterbench.simulation.generate import generate_split
from oysterbench.recipe import parse_split

if __name__ == "__main__":
    recipe, rig, out, victims = sys.argv[1:]
    split = parse_split(Path(recipe).read_text(), "tiny.toml", rig_source=Path(rig).read_text())
    with LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=None) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()][: int(victims)]

        def progress(done, total):
            if done >= 5 and pids:
                os.kill(pids.pop(), signal.SIGKILL)

        generate_split(split, Path(out), progress=progress, scheduler=cluster.scheduler_address)
        assert not pids
"""


@pytest.mark.slow
@pytest.mark.parametrize("victims", [0, 1])
def test_two_dask_workers_give_the_bytes_of_one_process(tiny_file, tmp_path, victims):
    script, recipe, rig, out = (tmp_path / name for name in ("render.py", "tiny.toml", "rig.toml", "out"))
    script.write_text(CLUSTER)
    recipe.write_text(TINY_SPLIT)
    rig.write_text(TINY_RIG)
    subprocess.run([sys.executable, script, recipe, rig, out, str(victims)], check=True, timeout=300)
    made, wanted = (hashlib.sha256(path.read_bytes()).hexdigest() for path in (out / "tiny-01.mcap", tiny_file))
    assert made == wanted
    assert sorted(path.name for path in out.iterdir()) == [".lock", COSTS, "tiny-01.mcap"]


def test_a_scheduler_that_does_not_answer_is_named(tiny_split, tmp_path, monkeypatch):
    monkeypatch.setattr("oysterbench.core.cluster.CONNECT_S", 0.2)
    with pytest.raises(OysterbenchError, match=r"--scheduler tcp://127.0.0.1:9: no Dask scheduler answers"):
        list(run_on_cluster(bytes, [b"job"], "tcp://127.0.0.1:9"))


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(OysterbenchError, match=r"pip install 'oysterbench\[cluster\]'"):
        list(run_on_cluster(bytes, [b"job"], "tcp://127.0.0.1:9"))


def test_a_worker_of_another_version_is_refused(tiny_split):
    with pytest.raises(OysterbenchError, match="install the same version on all workers"):
        make_part(tiny_split, Job("tiny-01"), b"", "cpu", PROGRAM + " of tomorrow")


def test_what_a_cluster_is_sent_shows_no_salt(tiny_split):
    """Dask writes the arguments of a failed task into its log."""
    import pickle
    from functools import partial

    secret = b"nobody may read this"
    task = partial(make_part, tiny_split, salt=Salt(secret), device="cpu", program=PROGRAM)
    sent = pickle.loads(pickle.dumps(task))
    assert sent.keywords["salt"] == secret
    for text in (repr(sent), str(sent.keywords), f"{sent.keywords['salt']}"):
        assert "nobody may read" not in text


def test_a_device_that_is_not_there_is_named(tiny_split, tmp_path):
    import warp

    if warp.is_cuda_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(OysterbenchError, match=r"--device cuda: there is no such device here; expected one of cpu"):
        generate_split(tiny_split, tmp_path, device="cuda")
