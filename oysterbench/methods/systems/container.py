"""Container recipe for a published system."""

from __future__ import annotations

from oysterbench.methods.systems.manifest import System
from oysterbench.version import VERSION

PYTORCH = """# https://download.pytorch.org/whl/cpu has PyTorch without CUDA, which is a fraction of the size.
ARG PIP_EXTRA_INDEX_URL
"""


def containerfile(system: System) -> str:
    """Text of a Containerfile: Debian with the system's packages, this project, and the built system."""
    packages = " ".join(["python3-venv", "git", *system.description.packages])
    described = system.description
    extras = "slam" if any(method.track == "slam" for method in described.methods.values()) else "score"
    if described.renders:
        extras = f"render,{extras}"
    index = PYTORCH if any(requirement.startswith("torch") for requirement in described.python) else ""
    return f"""# {described.title} ({described.licence}), built from its own source, and oysterbench, which runs it.
FROM docker.io/library/debian:bookworm-slim
# The wheel of a release, or an address that pip takes.
ARG OYSTERBENCH="oysterbench[{extras}]=={VERSION}"
{index}RUN apt-get update && apt-get install --yes --no-install-recommends {packages} && rm -rf /var/lib/apt/lists/*
# Also for the packages of a system that is in Python.
ENV PIP_NO_CACHE_DIR=1
RUN python3 -m venv /opt/oysterbench && /opt/oysterbench/bin/pip install "$OYSTERBENCH"
ENV PATH=/opt/oysterbench/bin:$PATH OYSTERBENCH_HOME=/data
# The build is in /data/systems: mount volumes on other folders below /data (/data/splits), not on /data itself.
RUN oysterbench systems build {system.name}
ENTRYPOINT ["oysterbench"]
"""
