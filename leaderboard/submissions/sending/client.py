"""Client of a leaderboard: sends a submission and asks for its outcome. Failed requests can safely be retried: the same
bytes for the same method and split are one submission, however often they arrive."""

from __future__ import annotations

import time
import urllib.parse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import urllib3

from oysterbench.core.errors import HubError, NetworkError
from oysterbench.core.names import PLAIN, is_plain
from oysterbench.core.text import in_one_line, read_json
from oysterbench.hub.pool import open_pool
from oysterbench.hub.sources import HOST, RETRIED, Patience, has_host, retry_after_s
from oysterbench.hub.transfer import pause_s
from oysterbench.version import VERSION
from oysterbench_leaderboard.submissions.reading.refusals import STATUS
from oysterbench_leaderboard.submissions.sending.package import Package

MOST_ANSWER = 64_000_000
WAIT_S = (1.0, 10.0)
"""Pause between two requests for a submission that is not scored yet: the first, and the longest."""

STARTING_S, STARTING_PAUSE_S = 60.0, 0.5
"""Time for which a server that refuses connections may be starting, and the pause between two attempts."""

CHECKED_S = 300.0
"""Time within which a server answers."""

NO_BOARD = "no leaderboard that takes submissions is there: expected the address of its first page"
"""Message where something else is at the address."""

REFUSED_FOR_GOOD = ("quota", "guessing", "slow")
"""Kinds of refusals that are not retried, although their HTTP status normally is."""

Progress = Callable[[int, int], None]
"""Called with the number of bytes sent, and that of all bytes."""


class Refused(HubError):
    """A refusal by the server; the message is its reason. kind: the server's name for it."""

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind


class NobodyThereError(NetworkError):
    """Nothing answers at the address."""


class Client:
    """Client of one server, with the token of a team. starting_s: how long to wait for a server that is starting;
    notify: called with a sentence for the user when it waits."""

    def __init__(
        self,
        url: str,
        token: str = "",
        patience: Patience | None = None,
        starting_s: float = STARTING_S,
        notify: Callable[[str], None] = lambda text: None,
    ) -> None:
        if url.partition("://")[0].lower() not in ("http", "https") or not has_host(url):
            meant = f"; did you mean http://{url}?" if HOST.fullmatch(url) else ""
            raise HubError(f"--to: expected the address of a leaderboard, https://..., got {url!r}{meant}")
        parts = urllib.parse.urlsplit(url)
        self.url = url.rstrip("/")
        self.open = parts.scheme == "http" and parts.hostname not in ("localhost", "127.0.0.1", "::1")
        self._patience = patience or Patience()
        self._starting_s, self._notify = starting_s, notify
        self._met = False  # once a server has answered, wait for it while it restarts
        # The server reads and checks an upload before it answers.
        self._pool = open_pool(self.url, 1, replace(self._patience, idle_s=CHECKED_S, window_s=CHECKED_S))
        self._headers = {"User-Agent": f"oysterbench/{VERSION}", "Accept": "application/json"}
        if token:
            self._headers["Authorization"] = f"Bearer {token}"

    def splits(self) -> dict[str, Any]:
        """Return the splits that the server accepts, and its limits. Raises Refused where it does not know the token,
        and HubError where it does not take submissions, or where a name could lead to files that were not named."""
        try:
            found = self._when_started("GET", "/api/submissions/splits")
        except Refused as refused:
            if refused.kind not in STATUS:
                raise HubError(f"{self.url}: {NO_BOARD} ({str(refused).rpartition('refused: ')[2]})") from None
            raise
        if not {"splits", "limits"} <= found.keys():
            raise HubError(f"{self.url}: {NO_BOARD} (it answers something else)")
        for name in (name for one in found["splits"] for name in (one["split"], *one["sequences"])):
            if not isinstance(name, str) or not is_plain(name):
                raise HubError(f"{self.url}: expected names of splits and sequences of {PLAIN}, got {name!r:.60}")
        return found

    def send(self, package: Package, method: str, url: str, summary: str, progress: Progress) -> dict[str, Any]:
        """Send a package; return the submission, which is the existing one if the package was sent before."""
        wanted = package.wanted
        asked = {"method": method, "split": wanted.split, "track": wanted.track, "url": url, "summary": summary}
        asked["digest"] = package.digest  # so that a full quota is noticed before the upload
        path = f"/api/submissions?{urllib.parse.urlencode(asked)}"
        headers = {"Content-Type": package.content_type, "Content-Length": str(package.size)}
        return self._ask("POST", path, package.path, headers, progress)

    def get(self, id: str) -> dict[str, Any]:
        """Return a submission in its present state."""
        return self._ask("GET", f"/api/submissions/{urllib.parse.quote(id, safe='')}")

    def publish(self, id: str) -> dict[str, Any]:
        """Publish a submission on the board."""
        return self._ask("POST", f"/api/submissions/{urllib.parse.quote(id, safe='')}/publish")

    def wait(self, id: str, on_change: Callable[[dict[str, Any]], None] = lambda found: None) -> dict[str, Any]:
        """Wait until a submission is scored, and return it; `on_change` is called on each change of its state."""
        pause, state = WAIT_S[0], ""
        while True:
            found = self.get(id)
            if found["state"] != state:
                state = found["state"]
                on_change(found)
            if state not in ("queued", "running"):
                return found
            time.sleep(pause)
            pause = min(1.5 * pause, WAIT_S[1])

    def _when_started(self, method: str, path: str) -> dict[str, Any]:
        """Ask a server that may have been started a moment ago."""
        end, told = time.monotonic() + self._starting_s, False
        while True:
            try:
                return self._ask(method, path)
            except NobodyThereError:
                if time.monotonic() >= end:
                    raise
            if not told:
                self._notify(f"{self.url}: nothing answers yet; trying for {self._starting_s:.0f} s")
                told = True
            time.sleep(STARTING_PAUSE_S)

    def _ask(
        self,
        method: str,
        path: str,
        body: Path | None = None,
        headers: dict[str, str] | None = None,
        progress: Progress = lambda done, total: None,
    ) -> dict[str, Any]:
        failure = ""
        for attempt in range(1, self._patience.attempts + 1):
            asked_s = 0.0
            try:
                status, answer, asked_s = self._once(method, path, body, {**self._headers, **(headers or {})}, progress)
                self._met = True
                if 200 <= status < 300:
                    return answer
                reason = str(answer.get("reason", f"status {status}"))
                if status not in RETRIED or answer.get("error") in REFUSED_FOR_GOOD:
                    raise Refused(str(answer.get("error", status)), f"{self.url}: refused: {reason}")
                failure = reason
                if asked_s > self._patience.longest_wait_s:
                    break
            except (urllib3.exceptions.HTTPError, OSError) as error:
                cause = getattr(error, "reason", error)
                if isinstance(cause, urllib3.exceptions.NewConnectionError) and not self._met:
                    kind = NobodyThereError if _is_refused(cause) else NetworkError
                    raise kind(
                        f"{self.url}: nothing answers at this address: is it right, and is the leaderboard running?"
                    ) from None
                failure = in_one_line(error)
            if attempt < self._patience.attempts:
                time.sleep(pause_s(attempt, asked_s, self._patience))
        raise NetworkError(
            f"{self.url}: no answer after {self._patience.attempts} attempts: {failure}; run the same command again: "
            "what has arrived whole is one submission; each attempt counts as an upload of the day"
        )

    def _once(
        self, method: str, path: str, body: Path | None, headers: dict[str, str], progress: Progress
    ) -> tuple[int, dict[str, Any], float]:
        """Send one request; return the status, the answer, and the wait in s that the answer asks for."""
        url = f"{self.url}{path}"
        if body is None:
            response = self._pool.request(method, url, headers=headers, redirect=False, preload_content=False)
        else:
            with open(body, "rb") as file:
                chunks = _counted(file, body.stat().st_size, progress)
                response = self._pool.request(
                    method, url, body=chunks, headers=headers, redirect=False, preload_content=False
                )
        try:
            data = response.read(MOST_ANSWER)
        finally:
            response.release_conn()
        try:
            answer = read_json(data)
        except ValueError:
            answer = {"reason": f"status {response.status}, and no answer in JSON: {data[:60]!r}"}
        asked_s = retry_after_s(response.headers.get("Retry-After"))
        return response.status, answer if isinstance(answer, dict) else {}, asked_s


def _is_refused(error: urllib3.exceptions.NewConnectionError) -> bool:
    """Whether a machine is there on which nobody listens, and not, for example, an unknown name."""
    return isinstance(error.__cause__ or error.__context__, ConnectionRefusedError)


def _counted(file: IO[bytes], total: int, progress: Progress) -> Iterator[bytes]:
    done = 0
    while chunk := file.read(1 << 16):
        yield chunk
        done += len(chunk)
        progress(done, total)
