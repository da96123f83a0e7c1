"""Runs of the steering track as its figures show them: on labelled images, and as rollouts."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.evaluate.steering import Commands, Labels, PictureScore, RolloutLog
from oysterbench.results.records import ResultRecord


@dataclass(frozen=True)
class PictureRun:
    """A method on the labelled images of a sequence; without labels, commands and score where it failed."""

    record: ResultRecord
    labels: Labels | None = None
    commands: Commands | None = None
    score: PictureScore | None = None

    @property
    def result(self) -> PictureScore | None:
        """Result for figures, None where the run failed."""
        return self.score


@dataclass(frozen=True)
class RolloutRun:
    """A rollout of a policy on a reef; without a log where it failed."""

    record: ResultRecord
    log: RolloutLog | None = None

    @property
    def result(self) -> RolloutLog | None:
        """Result for figures, None where the run failed."""
        return self.log
