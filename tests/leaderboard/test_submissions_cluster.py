"""Scoring on a Dask cluster, of uploads in a folder or in S3: what a lost worker was at is done once, by another."""

from __future__ import annotations

import os
import signal
from contextlib import closing
from pathlib import Path

import pytest

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.version import VERSION
from oysterbench_leaderboard.submissions import queue
from oysterbench_leaderboard.submissions.accounts.tokens import issue
from oysterbench_leaderboard.submissions.database import log
from oysterbench_leaderboard.submissions.estimates import Estimates, upload_of
from oysterbench_leaderboard.submissions.words import Form
from tests.helpers.clusters import two_workers, workers_of
from tests.helpers.kills import scored_again
from tests.helpers.pool import answers, lay_split
from tests.helpers.served import FAST, free_port, make_service
from tests.helpers.waiting import until


@pytest.fixture
def s3(monkeypatch):
    """The URL of a folder in a store that is new."""
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    values = {"ENDPOINT_URL": f"http://{host}:{port}", "ACCESS_KEY_ID": "x", "SECRET_ACCESS_KEY": "x"}
    for key, value in {**values, "DEFAULT_REGION": "us-east-1"}.items():
        monkeypatch.setenv(f"AWS_{key}", value)
    import fsspec

    fsspec.filesystem("s3", skip_instance_cache=True).mkdir("board")
    yield "s3://board/estimates"
    server.stop()


def scoring(cluster) -> int | None:
    """A worker whose sandbox is at work; None where there is none yet."""
    for worker in workers_of(cluster):
        for thread in Path(f"/proc/{worker}/task").iterdir():
            for child in (thread / "children").read_text().split():
                if b"sandbox_worker" in Path(f"/proc/{child}/cmdline").read_bytes():
                    return worker
    return None


def sent(service, folder, count: int) -> list[str]:
    """So many submissions of a team."""
    issue(service.database, "reef lab")
    made = []
    for case in range(count):
        file = service.incoming / f"x{case}"
        file.write_bytes(answers(folder, case))
        made.append(service.submit("reef lab", Form("carp", "pool-test"), upload_of(file))[0].id)
    return made


def ended(service) -> bool:
    """Whether nothing waits, nor is scored."""
    return all(one.state not in ("queued", "running") for one in service.of_team("reef lab"))


@pytest.mark.slow
@pytest.mark.parametrize("where", ["folder", "s3"])
def test_what_a_killed_worker_was_at_is_scored_once_by_another(where, request, tmp_path):
    pytest.importorskip("distributed")
    place = request.getfixturevalue("s3") if where == "s3" else ""
    lay_split(tmp_path / "splits")
    with closing(make_service(tmp_path, estimates=place, **FAST)) as service, two_workers() as cluster:
        made = sent(service, tmp_path, 4)
        dispatcher = queue.Dispatcher(service, scheduler=cluster.scheduler_address)
        dispatcher.start()
        until(lambda: scoring(cluster))
        os.kill(scoring(cluster), signal.SIGKILL)
        until(lambda: ended(service))
        dispatcher.stop()
        found = service.of_team("reef lab")
        assert {one.id: one.state for one in found} == dict.fromkeys(made, "done")
        assert {one.attempt for one in found} == {1}
        with service.database.reading() as connection:
            assert sorted(e["submission"] for e in log(connection) if e["what"] == "done") == sorted(made)
        assert [one.record for one in found] == [scored_again(service, one) for one in found]
        assert any((tmp_path / "private").glob("estimates/*")) == (where == "folder")


@pytest.mark.slow
def test_what_a_lost_scheduler_was_at_is_scored_when_it_is_back(tmp_path):
    pytest.importorskip("distributed")
    lay_split(tmp_path / "splits")
    port = free_port()
    with closing(make_service(tmp_path, **FAST)) as service:
        made = sent(service, tmp_path, 2)
        dispatcher = queue.Dispatcher(service, scheduler=f"tcp://127.0.0.1:{port}")
        dispatcher.start()
        with two_workers(port) as cluster:
            until(lambda: scoring(cluster))
        assert not ended(service)
        with two_workers(port):
            until(lambda: ended(service))
        dispatcher.stop()
        assert {one.id: one.state for one in service.of_team("reef lab")} == dict.fromkeys(made, "done")
        with service.database.reading() as connection:
            assert sorted(e["submission"] for e in log(connection) if e["what"] == "done") == sorted(made)


def test_uploads_in_a_store_are_checked_when_they_are_read(tmp_path):
    fsspec = pytest.importorskip("fsspec")
    store = Estimates("memory://board/estimates")
    file = tmp_path / "sent"
    file.write_bytes(b"0 0 0 0 0 0 0 1\n")
    upload = upload_of(file)
    store.keep(upload)
    with store.opened(upload.digest) as path:
        assert path.read_bytes() == file.read_bytes()
    assert not path.exists()
    with fsspec.open(f"memory://board/estimates/{upload.digest}", "wb") as changed:
        changed.write(b"1 0 0 0 0 0 0 1\n")
    with pytest.raises(ResultError, match="its bytes do not match its name"), store.opened(upload.digest):
        pass
    with pytest.raises(FileNotFoundError), store.opened("0" * 64):
        pass
    with pytest.raises(ResultError, match=r"pip install 'oysterbench\[s3\]'"):
        Estimates("nowhere://board").keep(upload)


def test_a_worker_of_another_version_is_refused():
    with pytest.raises(OysterbenchError, match=f"a worker has oysterbench {VERSION}, and was asked by 0: install one"):
        queue.perform_remotely(None, "0")
