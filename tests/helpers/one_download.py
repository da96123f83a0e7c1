"""A process that downloads one split and prints what it got: `one_download.py URL KEY FOLDER [no-locks]`."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

from urllib3.connection import HTTPConnection

from oysterbench.core import locks
from oysterbench.hub.download import Hub, download


def main() -> None:
    url, key, folder, *options = sys.argv[1:]
    # What the system holds when the process is killed says nothing about the process: it is kept small.
    HTTPConnection.default_socket_options = [(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)]
    if "no-locks" in options:

        def no_lock(path: Path, **how: bool):
            raise OSError("no locks here")

        locks.locked = no_lock  # type: ignore[assignment]
    hub = Hub.at([url], key)
    for path in download(hub, hub.manifest("big"), Path(folder)).values():
        print(path)


if __name__ == "__main__":
    main()
