"""Install what is asked for, editable and in the pinned versions, beside the Python that runs this.

By uv, which takes half of pip's time, from where pip would take packages; by pip itself where uv cannot be had or
does not get through. What nobody imports need not be compiled: that is most of torch, and a third of pip's time.
"""

from __future__ import annotations

import os
import subprocess
import sys

PINS = ("--constraint", ".ci/constraints.txt")
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")
SETTINGS = {
    "index-url": ("UV_DEFAULT_INDEX", " "),
    "extra-index-url": ("UV_INDEX", " "),
    "find-links": ("UV_FIND_LINKS", ","),
    "cert": ("SSL_CERT_FILE", " "),
}
"""Of pip: uv's names for them, and what stands between several values."""


def uv_settings(listed: str) -> dict[str, str]:
    """What uv's environment needs to find packages where pip does, by the lines of `pip config list`: those of the
    environment come first, as they count for more."""
    found = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # of all places, as pip chooses, not of the first that has any
    for line in listed.splitlines():
        key, _, value = line.partition("=")
        if setting := SETTINGS.get(key.rpartition(".")[2]):
            found.setdefault(setting[0], setting[1].join(value.strip("'\"").replace("\\n", " ").split()))
    return found


def by_uv(wanted: str) -> bool:
    """Whether uv could be had, and has installed it."""
    if subprocess.run([*PIP, "install", "--quiet", *PINS, "uv"], stderr=subprocess.DEVNULL).returncode:
        return False
    listed = subprocess.run([*PIP, "config", "list"], capture_output=True, text=True).stdout
    uv = [sys.executable, "-m", "uv", "pip", "install", "--quiet", "--python", sys.executable]
    if subprocess.run([*uv, *PINS, "--editable", wanted], env=uv_settings(listed) | os.environ).returncode:
        print("uv did not get through, so pip installs it, which takes longer", file=sys.stderr)
        return False
    return True


def by_pip(wanted: str) -> int:
    """Its exit status. The pip that comes with Python 3.11 takes twice as long to find out which versions go together;
    those from 26 on print a thousand lines of the build's warnings."""
    subprocess.run([*PIP, "install", "--quiet", *PINS, "--upgrade", "pip"])
    return subprocess.run([*PIP, "install", "--quiet", "--no-compile", *PINS, "--editable", wanted]).returncode


if __name__ == "__main__":
    try:
        sys.exit(0 if by_uv(sys.argv[1]) else by_pip(sys.argv[1]))
    except KeyboardInterrupt:
        sys.exit("interrupted: the same command goes on")
