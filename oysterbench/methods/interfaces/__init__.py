"""The interfaces of methods by the track that a method says it is of; each is loaded when it is asked for."""

from __future__ import annotations

from importlib import import_module

from oysterbench.methods.interfaces.interface import Interface, Predicted, RunSequence, Stopwatch

MODULES = {"slam": "slam", "segmentation": "images", "detection": "images", "steering": "steering"}
"""Track of a method -> module here whose `INTERFACE` speaks to it."""

__all__ = ["MODULES", "Interface", "Predicted", "RunSequence", "Stopwatch", "interface_of", "track_of_command"]


def interface_of(track: str) -> Interface:
    """The interface of the methods of a track. Raises KeyError for a track that has no methods."""
    found = import_module(f"{__name__}.{MODULES[track]}").INTERFACE
    assert isinstance(found, Interface)
    return found


def track_of_command(template: str) -> str:
    """The first track whose programs are given what a command line asks for; the first of all if there is none."""
    asking = (track for track in MODULES if any(f"{{{form}}}" in template for form in interface_of(track).forms))
    return next(asking, next(iter(MODULES)))
