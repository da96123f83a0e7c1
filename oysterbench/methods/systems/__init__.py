"""Published systems: programs of others, obtained, built, configured and run by one command each.

A package names its systems under the entry points `oysterbench.systems`; each is a folder with `system.toml`
(`manifest`), what builds it (`building`), and `configure.py` (`launch`). `adapter` runs one as a method.
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
