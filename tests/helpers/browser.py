"""A browser without a window, spoken to over pipes in the protocol of its developer tools."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WAIT_S = 120.0
"""For a page or an answer, on a machine that does much else."""


START = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(given), fcntl.F_DUPFD, 10) for given in sys.argv[1:3]]
for wanted, end in zip((3, 4), ends):
    os.dup2(end, wanted)
    os.close(end)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""Begins the browser, which reads commands from descriptor 3 and writes answers to 4."""


class Browser:
    """One tab. messages: what the page logged, and errors."""

    def __init__(self, folder: Path) -> None:
        assert CHROMIUM is not None
        here, there = os.pipe(), os.pipe()  # commands to it, answers from it
        command = [
            sys.executable, "-I", "-c", START, str(here[0]), str(there[1]), CHROMIUM,
            "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars",
            "--no-first-run", "--disable-extensions", "--remote-debugging-pipe", f"--user-data-dir={folder}",
        ]  # fmt: skip
        self.process = subprocess.Popen(
            command,
            pass_fds=(here[0], there[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(here[0])
        os.close(there[1])
        self._out, self._in = here[1], there[0]
        self._buffer, self._number = b"", 0
        self._events: list[dict[str, Any]] = []
        self.messages: list[str] = []
        target = self._send("Target.createTarget", {"url": "about:blank"})["targetId"]
        attached = self._send("Target.attachToTarget", {"targetId": target, "flatten": True})
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def close(self) -> None:
        """End it, and wait for that."""
        with contextlib.suppress(OSError, AssertionError):
            self._write({"id": 0, "method": "Browser.close"})
        os.close(self._out)
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self._in)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command to the tab."""
        return self._send(method, parameters, self._session)

    def _send(self, method: str, parameters: dict[str, Any], session: str | None = None) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        self._write({**message, "sessionId": session} if session else message)
        end = time.monotonic() + WAIT_S
        while True:
            answer = self._read(end)
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def _write(self, message: dict[str, Any]) -> None:
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._out, data) :]

    def _read(self, end: float) -> dict[str, Any]:
        """The next message; events are kept."""
        while b"\0" not in self._buffer:
            left = end - time.monotonic()
            assert left > 0, "the browser does not answer"
            if select.select([self._in], [], [], left)[0]:
                data = os.read(self._in, 1 << 16)
                assert data, "the browser has ended"
                self._buffer += data
        text, _, self._buffer = self._buffer.partition(b"\0")
        message = json.loads(text)
        if "method" in message:
            self._events.append(message)
            if message["method"] == "Runtime.exceptionThrown":
                self.messages.append(message["params"]["exceptionDetails"]["text"])
            if message["method"] == "Log.entryAdded" and message["params"]["entry"]["level"] in ("error", "warning"):
                self.messages.append(message["params"]["entry"]["text"])
        return message

    def _wait_for(self, event: str) -> None:
        end = time.monotonic() + WAIT_S
        while not any(message["method"] == event for message in self._events):
            self._read(end)

    def go(self, address: str) -> None:
        """Open a page, and wait until it is there."""
        self._events.clear()
        self.call("Page.navigate", url=address)
        self._wait_for("Page.loadEventFired")

    def follow(self, script: str) -> None:
        """Do what leads to another page, and wait until it is there."""
        self._events.clear()
        self.value(script)
        self._wait_for("Page.loadEventFired")

    def value(self, script: str) -> Any:
        """What an expression is on the page."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def until(self, script: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + WAIT_S
        while not self.value(script):
            assert time.monotonic() < end, f"never true: {script}"
            self.value("new Promise((done) => setTimeout(done, 50))")

    def look(self, width: int, dark: bool = False, script: bool = True) -> None:
        """Be of a width, in light or dark, with or without scripts: from the next page on."""
        mobile = width < 500
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=mobile)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Emulation.setScriptExecutionDisabled", value=not script)

    def picture(self) -> bytes:
        """The whole page as PNG."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": min(size["height"], 8000), "scale": 1}
        data = self.call("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)["data"]
        return base64.b64decode(data)


@contextlib.contextmanager
def browsing() -> Iterator[Browser]:
    """A browser, ended at the end."""
    with tempfile.TemporaryDirectory(prefix="oysterbench-browser-", ignore_cleanup_errors=True) as folder:
        browser = Browser(Path(folder))
        try:
            yield browser
        finally:
            browser.close()
