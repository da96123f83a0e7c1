"""Container recipe for a published system."""

from __future__ import annotations

from oysterbench.methods.systems.manifest import System
from oysterbench.version import VERSION


def containerfile(system: System) -> str:
    """Text of a Containerfile: Debian with the system's packages, this project, and the built system."""
    packages = " ".join(["python3-venv", "git", *system.description.packages])
    described = system.description
    extras = "slam" if any(method.track == "slam" for method in described.methods.values()) else "score"
    if described.renders:
        extras = f"render,{extras}"
    return f"""# {described.title} ({described.licence}), built from its own source, and oysterbench, which runs it.
FROM docker.io/library/debian:bookworm-slim
# The wheel of a release, or an address that pip takes.
ARG OYSTERBENCH="oysterbench[{extras}]=={VERSION}"
RUN apt-get update && apt-get install --yes --no-install-recommends {packages} && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/oysterbench && /opt/oysterbench/bin/pip install --no-cache-dir "$OYSTERBENCH"
ENV PATH=/opt/oysterbench/bin:$PATH OYSTERBENCH_HOME=/data
# The build is in /data/systems: mount volumes on other folders below /data (/data/splits), not on /data itself.
RUN oysterbench systems build {system.name}
ENTRYPOINT ["oysterbench"]
"""
