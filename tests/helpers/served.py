"""A server of submissions for the splits of a pool, and requests to it.

python served.py FOLDER PORT    serves what `lay` has laid out there
"""

from __future__ import annotations

import http.client
import json
import os
import re
import socket
import subprocess
import sys
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from oysterbench_leaderboard.submissions.accounts.tokens import issue
from oysterbench_leaderboard.submissions.database import SubmissionDatabase, log
from oysterbench_leaderboard.submissions.settings import load_settings
from tests.helpers.paths import ROOT
from tests.helpers.waiting import until

POLL_S = 0.1
"""Between two questions: each is a connection, and milliseconds of the server, which has work to do meanwhile."""

FAST: dict[str, Any] = {"per_day": 1000, "per_split": 1000}
"""SubmissionSettings of the tests' servers, unless they ask for others."""


def lay(folder: Path, **settings: Any) -> dict[str, str]:
    """Lay out a server: four splits, and two teams with a token each, which are returned."""
    from tests.helpers.pool import lay_split  # a server does without

    splits = folder / "splits"
    for name, track, hidden in (
        ("pool-test", "slam", True),
        ("pool-masks", "segmentation", True),
        ("pool-val", "slam", False),
        ("pool-steer", "steering", True),
    ):
        lay_split(splits, name, track, hidden)
    private = folder / "private"
    private.mkdir()
    lines = [f"{key} = {value!r}" for key, value in {**FAST, **settings}.items()]
    (private / "settings.toml").write_text("\n".join(lines))
    database = SubmissionDatabase(load_settings(private))
    tokens = {team: issue(database, team) for team in ("reef lab", "others")}
    database.close()
    return tokens


def make_service(folder: Path, **changes: Any) -> Any:
    """The service that was laid out there."""
    from oysterbench_leaderboard.storage.store import RecordStore
    from oysterbench_leaderboard.submissions.catalogue import Catalogue, serve_split
    from oysterbench_leaderboard.submissions.service import Service

    splits, private = folder / "splits", folder / "private"
    names = sorted(path.stem for path in splits.glob("pool-*.toml"))
    served = [serve_split(str(splits / f"{n}.toml"), splits / f"{n}-truth", private / "catalogue") for n in names]
    return Service(load_settings(private, **changes), Catalogue(served), RecordStore(folder / "board"))


def drain(service: Any) -> int:
    """Score all that waits; how many attempts that took."""
    from oysterbench_leaderboard.submissions import queue
    from oysterbench_leaderboard.submissions.database import find, log, submissions

    def attempts() -> int:
        with service.database.reading() as connection:
            return sum(event["what"] == "running" for event in log(connection, limit=100_000))

    def enough() -> bool:
        with service.database.reading() as connection:
            return not find(connection, submissions.c.state.in_(("queued", "running")))

    before = attempts()
    with service.database.alone() as connection:
        queue.dispatch(service, connection, queue.in_threads(1), enough)
    return attempts() - before


def serve(folder: Path, port: int) -> None:
    """Until it is killed."""
    import uvicorn

    from oysterbench.hub.connections import server_settings
    from oysterbench_leaderboard.boards.index import open_index
    from oysterbench_leaderboard.site.render import server_links
    from oysterbench_leaderboard.site.server import application
    from oysterbench_leaderboard.site.site import Site
    from oysterbench_leaderboard.submissions.web import Submissions

    service = make_service(folder)
    index = open_index(service.store, str(folder / "index.sqlite"))
    service.changed = index.refresh
    submissions = Submissions(service, server_links())
    app = application(Site(index, form=submissions.form), more=submissions.routes())
    submissions.attach(app)
    uvicorn.run(**server_settings(app, "127.0.0.1", port, "on"))


def free_port() -> int:
    """A port that nobody listens on."""
    with closing(socket.socket()) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Server:
    """A server in a process of its own, and requests to it. seen: all that was answered."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, free_port()
        self.process: subprocess.Popen[bytes] | None = None
        self.seen = bytearray()

    def begin(self) -> subprocess.Popen[bytes]:
        """A process that will answer in a moment."""
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with open(self.folder / "server.log", "ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.helpers.served", str(self.folder), str(self.port)],
                cwd=ROOT,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env=environment,
            )
        return self.process

    def start(self) -> None:
        """Returns when it answers."""
        process = self.begin()
        until(lambda: self.alive() or process.poll() is not None, poll_s=POLL_S)
        assert process.poll() is None, (self.folder / "server.log").read_text()

    def alive(self) -> bool:
        """Whether it answers."""
        try:
            return self.ask("GET", "/api/submissions/splits")[0] == 200
        except OSError:
            return False

    def ask(
        self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None, token: str = ""
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of an answer."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)) as connection:
            bearer = {"Authorization": f"Bearer {token}"} if token else {}
            connection.request(method, path, body, {**bearer, **(headers or {})})
            answer = connection.getresponse()
            data = answer.read()
            self.seen += repr(answer.getheaders()).encode() + data
            return answer.status, {k.lower(): v for k, v in answer.getheaders()}, data

    def send(self, token: str, body: bytes, kind: str = "application/zip", **asked: str) -> tuple[int, dict[str, Any]]:
        """Send a submission: status, and what was answered."""
        query = urlencode({"method": "carp", "split": "pool-test", **asked})
        found = self.ask("POST", f"/api/submissions?{query}", body, {"Content-Type": kind}, token)
        return found[0], json.loads(found[2])

    def wait(self, token: str, id: str) -> dict[str, Any]:
        """A submission when it is scored."""
        found: dict[str, Any] = {}

        def scored() -> bool:
            found.update(json.loads(self.ask("GET", f"/api/submissions/{id}", token=token)[2]))
            return found["state"] not in ("queued", "running")

        until(scored, poll_s=POLL_S)
        return found

    def stop(self) -> None:
        """End it in good order."""
        if self.process is not None:
            self.process.terminate()
            self.process.wait(60)


@contextmanager
def running(folder: Path) -> Any:
    """A server, stopped at the end."""
    server = Server(folder)
    server.start()
    try:
        yield server
    finally:
        server.stop()


class Site:
    """A server, its tokens, and its log of refusals."""

    def __init__(self, folder: Path, server: Server, tokens: dict[str, str]) -> None:
        self.folder, self.server, self.tokens = folder, server, tokens
        self.token = tokens["reef lab"]
        self.url = f"http://127.0.0.1:{server.port}"

    def events(self) -> list[dict[str, Any]]:
        """The log."""
        database = SubmissionDatabase(load_settings(self.folder / "private"))
        with database.reading() as connection:
            found = log(connection, limit=10_000)
        database.close()
        return found

    def count(self) -> int:
        """Submissions of the team."""
        return len(json.loads(self.server.ask("GET", "/api/submissions", token=self.token)[2])["submissions"])

    def signed_in(self, token: str = "") -> tuple[str, str]:
        """Cookie and CSRF token of a session of the form."""
        _, headers, page = self.server.ask("GET", "/submit/new")
        cookie, csrf = headers["set-cookie"].split(";")[0], csrf_in(page)
        status, headers, _ = self.post_form("/submit/sign-in", {"csrf": csrf, "token": token or self.token}, cookie)
        assert status == 303
        fresh = headers["set-cookie"].split(";")[0]
        assert fresh != cookie, "a session that was known before is worth nothing"
        return fresh, csrf_in(self.server.ask("GET", "/submit/new", headers={"Cookie": fresh})[2])

    def post_form(
        self, path: str, fields: dict[str, str], cookie: str, **headers: str
    ) -> tuple[int, dict[str, str], bytes]:
        """Send a form as a browser would: status, headers and body of the answer."""
        own = {
            "Content-Type": "application/x-www-form-urlencoded",
            "Cookie": cookie,
            "Origin": self.url,
            **headers,
        }
        return self.server.ask("POST", path, urlencode(fields), {k: v for k, v in own.items() if v})


def csrf_in(page: bytes) -> str:
    """The token of a form."""
    found = re.search(rb'name="csrf" value="([0-9a-f]{64})"', page)
    assert found
    return found[1].decode()


if __name__ == "__main__":
    serve(Path(sys.argv[1]), int(sys.argv[2]))
