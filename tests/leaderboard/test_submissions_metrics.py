"""What Prometheus is told of a server of submissions."""

from __future__ import annotations

import urllib.request
from contextlib import closing

import pytest
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy import update

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.submissions.database import submissions
from oysterbench_leaderboard.submissions.estimates import upload_of
from oysterbench_leaderboard.submissions.metrics import serve_metrics
from oysterbench_leaderboard.submissions.reading.refusals import FAILED
from oysterbench_leaderboard.submissions.words import Form
from tests.helpers.pool import answers, lay_split
from tests.helpers.served import free_port, make_service


@pytest.fixture
def service(tmp_path):
    lay_split(tmp_path / "splits")
    with closing(make_service(tmp_path)) as made:
        path = made.incoming / "carp"
        path.write_bytes(answers(tmp_path))
        made.submit("reef lab", Form("carp", "pool-test"), upload_of(path))
        yield made


def asked(port):
    """Name and labels -> value."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics") as answer:
        families = list(text_string_to_metric_families(answer.read().decode()))
    return {(one.name, *one.labels.values()): one.value for family in families for one in family.samples}


def test_they_tell_of_queue_failures_and_disks_as_they_are_now(service):
    port = free_port()
    stop = serve_metrics(service, f"127.0.0.1:{port}")
    try:
        found = asked(port)
        assert found["oysterbench_submissions", "queued"] == 1
        assert found["oysterbench_submissions", "failed"] == 0
        waited = found["oysterbench_queue_oldest_seconds",]
        assert waited >= 0
        service.clock = lambda: 4e9
        assert asked(port)["oysterbench_queue_oldest_seconds",] > 1e9
        assert (
            0
            < found["oysterbench_disk_free_bytes", "submissions"]
            < found["oysterbench_disk_total_bytes", "submissions"]
        )
        assert found["process_open_fds",] > 3
        assert any(key[0] == "oysterbench_info" and "Landlock" in str(key) for key in found)
        with service.database.writing() as connection:
            connection.execute(update(submissions).values(state="failed", reason=FAILED["none"] + "pool-01: no poses"))
        found = asked(port)
        assert (found["oysterbench_submissions", "queued"], found["oysterbench_submissions", "failed"]) == (0, 1)
        assert (found["oysterbench_failures", "none"], found["oysterbench_failures", "crash"]) == (1, 0)
        assert found["oysterbench_queue_oldest_seconds",] == 0
    finally:
        stop()
    with pytest.raises(OSError, match="refused"):
        asked(port)


@pytest.mark.parametrize("place", ["", "127.0.0.1", "127.0.0.1:x", "127.0.0.1:70000"])
def test_an_address_that_is_none_is_refused_in_a_line(service, place):
    with pytest.raises(ResultError, match=r"--metrics: expected HOST:PORT"):
        serve_metrics(service, place)
