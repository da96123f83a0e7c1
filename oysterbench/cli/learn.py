"""Command groups filled from entry points: `train`, `translate`, `experiment`. `cli.main` adds them."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

import click

from oysterbench.cli.groups import Group
from oysterbench.core.errors import MethodError


class Installed(Group):
    """Command group whose commands are entry points; each is a click command, loaded when it is needed."""

    def __init__(self, name: str, points: str, **settings: object) -> None:
        super().__init__(name, **settings)  # type: ignore[arg-type]
        self._points = points

    def found(self) -> dict[str, EntryPoint]:
        """Return the commands: name -> entry point."""
        return {point.name: point for point in entry_points(group=self._points)}

    def list_commands(self, context: click.Context) -> list[str]:
        return sorted(self.found())

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except ModuleNotFoundError as error:  # heavy modules are imported only when the command runs
            raise self._lacking(error) from None

    def _lacking(self, error: ImportError) -> MethodError:
        return MethodError(f"{self.name}: {error}; install what it needs, e.g. pip install 'oysterbench[learn]'")

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        point = self.found().get(name)
        if point is None:
            return None
        try:
            command = point.load()
        except ImportError as error:
            raise self._lacking(error) from None
        if not isinstance(command, click.Command):
            raise MethodError(f"{self.name} {name}: expected a click command, got {type(command)}")
        return command


train = Installed(
    "train",
    "oysterbench.train",
    short_help="Train a learned method.",
    help="""Train a learned method, on labelled images or on sequences, as its own help says.

    \b
    Examples:
      oysterbench train unet --data seg-train
      oysterbench train unet --help

    Methods register their commands in the entry-point group oysterbench.train.
    """,
)

experiment = Installed(
    "experiment",
    "oysterbench.experiment",
    short_help="Run an experiment: what rendered images add to real ones, and how far apart the two are.",
    help="""Run an experiment and print its table; it resumes after interruption.

    \b
    Examples:
      oysterbench experiment sim2real --real real-oysters --synthetic rendered=seg-train
      oysterbench experiment realism --real real-oysters --synthetic closeup=seg-closeup
      oysterbench experiment sim2real --help

    Experiments are registered in the entry-point group oysterbench.experiment.
    """,
)

translate = Installed(
    "translate",
    "oysterbench.translate",
    short_help="Make rendered images look like real ones.",
    help="""Change the appearance of labelled images; their labels stay the same.

    \b
    Examples:
      oysterbench translate reinhard --source seg-closeup \\
        --target real-oysters --out translated/reinhard
      oysterbench translate cut cut/checkpoint.pt --source seg-closeup --out translated/cut
      oysterbench translate cut --help

    Translations are registered in the entry-point group oysterbench.translate.
    """,
)
