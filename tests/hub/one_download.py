"""A process that downloads one split and prints what it got: `one_download.py URL KEY FOLDER [no-locks]`."""

from __future__ import annotations

import sys
from pathlib import Path

from oysterbench.hub import download as downloading
from oysterbench.hub.download import Hub, download


def main() -> None:
    url, key, folder, *options = sys.argv[1:]
    if "no-locks" in options:

        def no_lock(path: Path):
            raise OSError("no locks here")

        downloading.locked = no_lock  # type: ignore[assignment]
    hub = Hub.at([url], key)
    for path in download(hub, hub.manifest("big"), Path(folder)).values():
        print(path)


if __name__ == "__main__":
    main()
