"""axe-core, the checker of accessible pages that browsers' own tools use: from npm, where it is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path
from typing import Any

from tests.helpers.browser import CHROMIUM, Browser

WHY_NOT = "needs Chromium (apt-get install chromium) and axe-core (npm install -g axe-core, or OYSTERBENCH_AXE=FILE)"

RULES = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice")


@lru_cache(maxsize=1)
def axe_file() -> Path | None:
    """Its script: as OYSTERBENCH_AXE says, or among the packages that npm installed globally."""
    if given := os.environ.get("OYSTERBENCH_AXE"):
        return Path(given)
    if CHROMIUM is None or shutil.which("npm") is None:
        return None
    root = subprocess.run(["npm", "root", "-g"], capture_output=True, text=True, check=False, timeout=60).stdout.strip()
    found = Path(root, "axe-core", "axe.min.js")
    return found if root and found.is_file() else None


def violations(browser: Browser) -> list[str]:
    """Of the page that is shown: rule, what is wrong, and where."""
    script = axe_file()
    assert script is not None
    browser.value(f"{script.read_text(encoding='utf-8')};0")
    run = f"axe.run(document, {{runOnly: {list(RULES)}, resultTypes: ['violations']}})"
    listed = ".then((r) => r.violations.map((v) => [v.id, v.help, v.nodes.slice(0, 3).map((n) => n.html)]))"
    found: list[Any] = browser.value(run + listed)
    return [f"{rule}: {about}: {' | '.join(where)[:400]}" for rule, about, where in found]
