"""The interfaces to methods, by the track that a method declares; each is loaded on first use."""

from __future__ import annotations

from importlib import import_module

from oysterbench.methods.interfaces.interface import Interface, Predicted, RunSequence, Stopwatch

MODULES = {"slam": "slam", "segmentation": "images", "detection": "images", "steering": "steering"}
"""Track of a method -> module of this package whose `INTERFACE` handles it."""

__all__ = ["MODULES", "Interface", "Predicted", "RunSequence", "Stopwatch", "interface_of", "track_of_command"]


def interface_of(track: str) -> Interface:
    """Return the interface to the methods of a track. Raises KeyError for a track that has no methods."""
    found = import_module(f"{__name__}.{MODULES[track]}").INTERFACE
    assert isinstance(found, Interface)
    return found


def track_of_command(template: str) -> str:
    """Return the first track with an input form that a command line names; the first track of all if there is none."""
    asking = (track for track in MODULES if any(f"{{{form}}}" in template for form in interface_of(track).forms))
    return next(asking, next(iter(MODULES)))
