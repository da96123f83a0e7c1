"""Web servers for tests: an honest one that counts what it sends, and one that misbehaves in a chosen way."""

from __future__ import annotations

import contextlib
import random
import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

CHUNK = 1 << 16


@dataclass
class Site:
    """What a server has (path -> bytes), and what it was asked for."""

    files: dict[str, bytes]
    requests: list[tuple[str, int, int]] = field(default_factory=list)  # path, first byte, byte behind the last
    sent: int = 0  # bytes of bodies
    connections: int = 0  # that are open
    lock: threading.Lock = field(default_factory=threading.Lock)
    url: str = ""


class Honest(BaseHTTPRequestHandler):
    """Ranges done right."""

    protocol_version = "HTTP/1.1"
    site: Site
    pause: Callable[[], object] = staticmethod(lambda: None)

    def handle(self) -> None:
        with self.site.lock:
            self.site.connections += 1
        try:
            super().handle()
        finally:
            with self.site.lock:
                self.site.connections -= 1

    def log_message(self, *arguments: object) -> None:
        pass

    def do_GET(self) -> None:
        with contextlib.suppress(ConnectionError):
            self.answer()

    def wanted(self) -> tuple[bytes, int, int] | None:
        """The file with the range that is asked for; None after a 404."""
        data = self.site.files.get(self.path.lstrip("/"))
        if data is None:
            self.send_error(404)
            return None
        match = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        start, end = (int(match[1]), min(int(match[2]) + 1, len(data))) if match else (0, len(data))
        with self.site.lock:
            self.site.requests.append((self.path.lstrip("/"), start, end))
        return data, start, end

    def answer(self) -> None:
        if (wanted := self.wanted()) is not None:
            self.give(*wanted)

    def head(self, data: bytes, start: int, end: int, **headers: str) -> None:
        self.send_response(206 if "Range" in self.headers else 200)
        fields = {"Content-Length": str(end - start)}
        if "Range" in self.headers:
            fields["Content-Range"] = f"bytes {start}-{end - 1}/{len(data)}"
        for name, value in (fields | {key.replace("_", "-"): value for key, value in headers.items()}).items():
            self.send_header(name, value)
        self.end_headers()

    def give(self, data: bytes, start: int, end: int, **headers: str) -> None:
        self.head(data, start, end, **headers)
        self.body(data[start:end])

    def body(self, data: bytes) -> None:
        for k in range(0, len(data), CHUNK):
            self.pause()
            self.wfile.write(data[k : k + CHUNK])
            with self.site.lock:
                self.site.sent += len(data[k : k + CHUNK])

    def whole(self, data: bytes) -> None:
        """A 200, whatever was asked for."""
        self.send_response(200)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.body(data)

    def cut_off(self) -> None:
        """End the connection."""
        self.close_connection = True
        self.wfile.flush()


class Misbehaving(Honest):
    """Does one wrong thing, for a share of the requests, decided by a seeded generator."""

    kind: str
    share: float
    generator: random.Random

    def answer(self) -> None:
        if self.path.startswith("/moved/"):
            self.path = self.path.removeprefix("/moved")
        if (wanted := self.wanted()) is None:
            return
        with self.site.lock:
            misbehave = self.generator.random() < self.share
        if misbehave:
            getattr(self, self.kind)(*wanted)
        else:
            self.give(*wanted)

    def roll(self, n: int) -> int:
        with self.site.lock:
            return self.generator.randrange(n)

    def cut(self, data: bytes, start: int, end: int) -> None:
        self.head(data, start, end)
        self.body(data[start : start + self.roll(end - start)])
        self.cut_off()

    def ignores_range(self, data: bytes, start: int, end: int) -> None:
        if self.roll(3):
            self.whole(data)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.body(data[: self.roll(len(data))])
        self.cut_off()

    def wrong_content_range(self, data: bytes, start: int, end: int) -> None:
        other = self.roll(len(data) - 1)
        values = (
            f"bytes {other}-{other + end - start - 1}/{len(data)}",
            f"bytes {start}-{end + 4096}/{len(data)}",
            "bytes */7",
            f"bytes {'9' * 5000}-{'9' * 5000}/*",
            "pages 1-2/3",
            "",
        )
        self.send_response(206)
        self.send_header("Content-Range", values[self.roll(len(values))])
        self.send_header("Content-Length", str(end - start))
        self.end_headers()
        self.body(data[other : other + end - start].ljust(end - start, b"?"))

    def wrong_bytes(self, data: bytes, start: int, end: int) -> None:
        changed = bytearray(data)
        for _ in range(1 + self.roll(3)):
            changed[start + self.roll(end - start)] ^= 1 << self.roll(8)
        self.give(bytes(changed), start, end)

    def wrong_file(self, data: bytes, start: int, end: int) -> None:
        self.give(random.Random(start).randbytes(len(data)), start, end)

    def trickle(self, data: bytes, start: int, end: int) -> None:
        self.head(data, start, end)
        for k in range(start, min(end, start + 40)):
            self.wfile.write(data[k : k + 1])
            threading.Event().wait(0.01)
        self.cut_off()

    def trickled_headers(self, data: bytes, start: int, end: int) -> None:
        for letter in b"HTTP/1.1 206 Partial Content\r\nX: " + b"x" * 40:
            self.wfile.write(bytes([letter]))
            threading.Event().wait(0.01)
        self.cut_off()

    def interim(self, data: bytes, start: int, end: int) -> None:
        for _ in range(100):
            self.wfile.write(b"HTTP/1.1 100 Continue\r\n\r\n" * 1000)
        self.cut_off()

    def trickled_chunks(self, data: bytes, start: int, end: int) -> None:
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {start}-{end - 1}/{len(data)}")
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        for letter in b"1;" + b"x" * 40:
            self.wfile.write(bytes([letter]))
            threading.Event().wait(0.01)
        self.cut_off()

    def silence(self, data: bytes, start: int, end: int) -> None:
        self.head(data, start, end)
        threading.Event().wait(0.4)
        self.cut_off()

    def unavailable(self, data: bytes, start: int, end: int) -> None:
        values = ("0", "1", "3600", "Fri, 31 Dec 2100 23:59:59 GMT", "Fri, 31 Dec 1999 23:59:59 GMT", "soon", "\xb2")
        self.send_response((503, 429, 500, 408)[self.roll(4)])
        self.send_header("Retry-After", values[self.roll(len(values))])
        self.send_header("Content-Length", "5")
        self.end_headers()
        self.wfile.write(b"later")

    def unsatisfiable(self, data: bytes, start: int, end: int) -> None:
        self.send_response(416)
        self.send_header("Content-Range", f"bytes */{len(data) // 2}")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def redirect(self, data: bytes, start: int, end: int) -> None:
        places = (f"/moved{self.path}", f"{self.site.url}/moved{self.path}", self.path, "/moved/nowhere", "gopher://x/")
        self.send_response((301, 302, 307, 308)[self.roll(4)])
        self.send_header("Location", places[self.roll(len(places))])
        self.send_header("Content-Length", "0")
        self.end_headers()

    def truncated_chunks(self, data: bytes, start: int, end: int) -> None:
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {start}-{end - 1}/{len(data)}")
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        cut = start + self.roll(end - start)
        for k in range(start, cut, 5000):
            part = data[k : min(k + 5000, cut)]
            self.wfile.write(b"%x\r\n" % (len(part) + (1000 if k + 5000 >= cut else 0)) + part + b"\r\n")
        self.cut_off()

    def compressed(self, data: bytes, start: int, end: int) -> None:
        self.give(data, start, end, Content_Encoding="gzip")

    def too_long(self, data: bytes, start: int, end: int) -> None:
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {start}-{end - 1}/{len(data)}")
        self.end_headers()
        self.body(data[start:end] + b"more" * 5000)
        self.cut_off()

    def nonsense(self, data: bytes, start: int, end: int) -> None:
        answers = (
            b"",
            b"HTTP/1.1",
            b"\x16\x03\x01\x02\x00",
            b"HTTP/1.1 200 OK\r\nContent-Length: -5\r\n\r\n",
            b"\0" * 70000,
        )
        self.wfile.write(answers[self.roll(len(answers))])
        self.cut_off()


KINDS = (
    "cut",
    "ignores_range",
    "wrong_content_range",
    "wrong_bytes",
    "wrong_file",
    "trickle",
    "trickled_headers",
    "trickled_chunks",
    "silence",
    "unavailable",
    "unsatisfiable",
    "redirect",
    "truncated_chunks",
    "compressed",
    "too_long",
    "nonsense",
)


class Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 128

    def handle_error(self, request: object, client_address: object) -> None:
        pass


@contextlib.contextmanager
def serving(handler: type[Honest], files: dict[str, bytes], port: int = 0, **settings: object) -> Iterator[Site]:
    """A server on this machine while the block runs. port: 0 for a free one."""
    site = Site(files)
    server = Server(("127.0.0.1", port), type("Handler", (handler,), {"site": site, **settings}))
    site.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield site
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def misbehaving(kind: str, files: dict[str, bytes], seed: int, share: float):
    """A server that misbehaves in one way."""
    return serving(Misbehaving, files, kind=kind, share=share, generator=random.Random(f"{kind} {seed}"))
