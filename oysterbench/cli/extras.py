"""What to install when a command lacks a module: the extra of this package that provides it."""

from __future__ import annotations

import re
from importlib.metadata import requires

DISTRIBUTIONS = {
    "anyio": "starlette",
    "multipart": "python-multipart",
    "rerun": "rerun-sdk",
    "warp": "warp-lang",
}
"""Module -> distribution that provides it, if its name differs."""

OF_OTHERS = ("all", "dev", "docs")


def extra_of(module: str) -> str | None:
    """Name of the extra that provides a module; None if no extra does.

    >>> extra_of("uvicorn"), extra_of("warp.sim"), extra_of("numpy")
    ('serve', 'render', None)
    """
    top = module.partition(".")[0]
    wanted = DISTRIBUTIONS.get(top, top).replace("_", "-").lower()
    for text in requires("oysterbench") or ():
        found = re.match(r"([\w.-]+).*extra *== *['\"]([\w-]+)['\"]", text)
        if found and found[2] not in OF_OTHERS and found[1].replace("_", "-").lower() == wanted:
            return found[2]
    return None
