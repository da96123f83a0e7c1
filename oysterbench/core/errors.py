"""Errors that a user can act on. Only `oysterbench/cli/` prints them, as one line, and exits with `exit_code`."""

from __future__ import annotations


class OysterbenchError(Exception):
    """Expected failure; the message says what was expected, what was got, where, and what to do next."""

    exit_code = 1


class OptionError(OysterbenchError):
    """An option was given a value that it cannot have."""

    exit_code = 2


class RecipeError(OysterbenchError):
    """A split, rig or recipe is unknown, unreadable or holds a bad value."""


class SequenceError(OysterbenchError):
    """A sequence file is absent, truncated, damaged or of another kind."""


class NoTruthError(SequenceError):
    """A sequence has no ground truth: nobody recorded it, or it was withheld."""


class TrajectoryError(OysterbenchError):
    """A trajectory file or the poses in it cannot be scored."""


class NoStampsError(TrajectoryError):
    """A trajectory file gives no timestamps. poses: how many poses it has"""

    def __init__(self, message: str, poses: int) -> None:
        super().__init__(message)
        self.poses = poses


class MethodError(OysterbenchError):
    """A method is unknown, cannot be loaded, or its run gave no estimate."""


class MachineError(OysterbenchError):
    """The machine failed, not the code that ran on it: a process was killed from outside, e.g. when memory ran out."""


class ResultError(OysterbenchError):
    """A result file is unreadable or its records are not what this version writes."""


class LabelError(OysterbenchError):
    """Images, masks, boxes or annotations are absent, damaged, or do not belong together."""


class HubError(OysterbenchError):
    """A hub, an index or a manifest is not what it should be, or a request to one cannot be met."""


class NotOnHubError(HubError):
    """A hub has no split or weights of a name, or none of a version."""


class IntegrityError(HubError):
    """Bytes or a signature are wrong: a damaged file, a hostile or broken mirror."""

    exit_code = 3


class NetworkError(HubError):
    """No source could be reached, or none answered as it should."""

    exit_code = 4


class SilentError(NetworkError):
    """No server of a hub could be reached to ask for its index; where one answered, however wrongly, it is no such
    error, nor where a folder cannot be read."""


class MissingExtraError(OysterbenchError, ImportError):
    """A dependency of an optional part is not installed; the message says what to type."""
