"""Versions of the code and of what it makes."""

VERSION = "1.0.0"
"""Of the library and its commands, by semantic versioning."""

GENERATION = 4
"""Of what rendering makes: raised whenever the same recipe begins to give other bytes, so that no file of before is
taken for a new one. Files name it and not VERSION: a release of code that renders the same changes none."""
