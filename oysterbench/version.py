"""Versions of the code and of what it makes."""

VERSION = "1.0.0"
"""Version of the library and its commands, by semantic versioning."""

GENERATION = 4
"""Generation of rendered data: raised whenever the same recipe starts to give other bytes, so that no earlier file is
mistaken for a new one. Files state it and not VERSION: a release of code that renders the same changes none."""
