"""What newcomers find: an empty folder, and a home in which the minis are, once they were rendered."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def minis(tmp_path_factory) -> Path:
    """A home that all of them share, as each would render the same minis; OYSTERBENCH_TEST_HOME names one that has
    them already."""
    named = os.environ.get("OYSTERBENCH_TEST_HOME")
    return Path(named) if named else tmp_path_factory.mktemp("home")


@pytest.fixture
def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
