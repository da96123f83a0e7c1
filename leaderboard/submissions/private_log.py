"""The log of a server's private folder, for its operators only."""

from __future__ import annotations

import logging
import logging.handlers
import os
from pathlib import Path


def private_log(path: Path) -> logging.Logger:
    """Logger for operators only, with one rotating file per private folder."""
    log = logging.getLogger(f"oysterbench.submissions.{path.parent.resolve()}")
    log.propagate = False
    log.setLevel(logging.INFO)
    for handler in list(log.handlers):
        handler.close()
        log.removeHandler(handler)
    handler = logging.handlers.RotatingFileHandler(path, maxBytes=20_000_000, backupCount=5, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
    log.addHandler(handler)
    os.chmod(path, 0o600)
    return log
