"""What steering shows besides the tables of every track: confusions over pictures, and rollouts from above."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.evaluate.steering import Commands, Labels, PictureScore, RolloutLog
from oysterbench.results.records import ResultRecord


@dataclass(frozen=True)
class PictureRun:
    """A method over the labelled pictures of a sequence; without labels, commands and score where it failed."""

    record: ResultRecord
    labels: Labels | None = None
    commands: Commands | None = None
    score: PictureScore | None = None

    @property
    def result(self) -> PictureScore | None:
        """What there is to draw."""
        return self.score


@dataclass(frozen=True)
class RolloutRun:
    """A rollout of a policy over a reef; without a log where it failed."""

    record: ResultRecord
    log: RolloutLog | None = None

    @property
    def result(self) -> RolloutLog | None:
        """What there is to draw."""
        return self.log
