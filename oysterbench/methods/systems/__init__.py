"""Published systems: third-party programs, each obtained, built, configured and run with one command.

A package lists its systems in the entry-point group `oysterbench.systems`; each is a folder with `system.toml`
(`manifest`), its build files (`building`), and `configure.py` (`launch`). `adapter` runs one as a method.
"""

from oysterbench.methods.systems.manifest import (
    System,
    SystemMethod,
    find_system,
    split_reference,
    systems,
    track_of,
)

__all__ = ["System", "SystemMethod", "find_system", "split_reference", "systems", "track_of"]
