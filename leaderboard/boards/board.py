"""Types for what a board shows: its description, its rows, a page of rows. `index_writer.py` makes them, `index.py`
finds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args

from oysterbench.evaluate.detection import DetectionSettings
from oysterbench.evaluate.segmentation import SegmentationSettings
from oysterbench.evaluate.slam import SlamSettings
from oysterbench.results.records import plain

if TYPE_CHECKING:
    from oysterbench_leaderboard.storage.store import RecordStore

State = Literal["current", "superseded", "withdrawn"]
STATES: tuple[State, ...] = get_args(State)

DEFAULTS = {"slam": SlamSettings(), "segmentation": SegmentationSettings(), "detection": DetectionSettings()}
"""Track -> default settings of its evaluator, where these can be chosen."""

LEAST_DIGITS = 8
"""Least number of digits of an abbreviated record digest."""


@dataclass(frozen=True)
class BoardInfo:
    """A board: records whose numbers may be compared.

    id:        16 hex digits (`Record.board`)
    settings:  of the evaluator
    metric:    key of the ranking metric; columns: keys of the other metrics in its tables, in order
    sequences: of the split, by name: those that any ranked record has. A record without one failed there
    entries:   number of current records
    updated:   creation time of the newest of them
    newest:    whether it is not former, and no board of the same track, split and recipe has a later evaluator; the
               others are history
    former:    whether the split has records of a later recipe: its data has changed since
    public:    whether a ranked record says that the split is not hidden; records of earlier versions do not say it
    """

    id: str
    track: str
    split: str
    split_digest: str
    evaluator_version: str
    settings: Mapping[str, Any]
    metric: str
    columns: tuple[str, ...]
    sequences: tuple[str, ...]
    entries: int
    updated: str
    newest: bool
    former: bool = False
    public: bool = False

    @property
    def scored_by(self) -> str:
        """The evaluator with its non-default settings, which tell boards of one split apart."""
        return ", ".join(
            [self.evaluator_version, *(f"{key} = {value}" for key, value in self.changed_settings.items())]
        )

    @property
    def has_defaults(self) -> bool:
        """Whether the evaluator's default settings are known."""
        return self.track in DEFAULTS

    @property
    def changed_settings(self) -> dict[str, Any]:
        """Settings that differ from the evaluator's defaults; empty where the defaults are not known."""
        defaults = plain(asdict(DEFAULTS[self.track])) if self.track in DEFAULTS else self.settings
        return {key: value for key, value in self.settings.items() if defaults.get(key) != value}


@dataclass(frozen=True)
class Row:
    """A record on its board.

    place:     by the mean of the ranking metric alone; equal means share one. None for records that have no value, are
               not current, or are self-reported
    rank:      by significance (`oysterbench.results.standings`); None with too few sequences, or without a place
    tied:      whether another record has the same rank, or the same place where there are no ranks
    score:     mean of the ranking metric over all sequences of the board; low, high: its confidence interval, None
               where there are too few sequences
    data_set:  the ranking metric over all sequences at once, if the record has it, such as COCO's AP: shown but not
               used for ranking, as a paired comparison needs a value on each sequence
    coverage:  mean over sequences, for tracks that have it
    metrics:   means of the columns, including coverage where it is one; for errors, medians over the sequences that are
               not lost; None where there is no value
    failures:  number of failed runs, plus sequences without an estimate
    lost:      number of sequences of the board that are lost (`oysterbench.results.lost`), including those without an
               estimate; None where the track does not define it
    sensors, mode: sensors that the method states it uses, and "online" or "offline"; code, paper: where its program is,
               and the paper that describes it; each empty where it states nothing
    machine:   on which its speeds were measured; empty where it is not stated, or there were several
    """

    digest: str
    board: str
    method: str
    team: str
    tier: str
    url: str
    summary: str
    created: str
    supersedes: str
    state: State
    place: int | None
    rank: int | None
    tied: bool
    score: float | None
    low: float | None
    high: float | None
    data_set: float | None
    coverage: float | None
    metrics: Mapping[str, float | None]
    sequences: int
    runs: int
    failures: int
    lost: int | None = None
    sensors: str = ""
    mode: str = ""
    code: str = ""
    paper: str = ""
    machine: str = ""


@dataclass(frozen=True)
class Query:
    """A query for rows of a board.

    sort:     "rank", "method", "team", "created", "score", "data_set", "coverage", "lost", or a column's key;
              descending: in reverse order. Records without the value are last either way
    text:     to find in method or team, ignoring case; tiers: empty for all
    states:   of the wanted records; superseded and withdrawn ones have no place
    page:     from 1; size: rows per page
    """

    sort: str = "rank"
    descending: bool = False
    text: str = ""
    tiers: tuple[str, ...] = ()
    states: tuple[State, ...] = ("current",)
    page: int = 1
    size: int = 50


@dataclass(frozen=True)
class BoardPage:
    """One page of the rows that a query selects; total: number of rows on all pages."""

    board: BoardInfo
    query: Query
    rows: tuple[Row, ...]
    total: int

    @property
    def pages(self) -> int:
        return max(1, -(-self.total // self.query.size))


class BoardReader(Protocol):
    """Interface for reading boards, from a database (`index.BoardIndex`) or from records in memory."""

    @property
    def store(self) -> RecordStore: ...

    @property
    def revision(self) -> str: ...

    def boards(self, track: str | None = None) -> list[BoardInfo]: ...

    def page(self, board: str, query: Query) -> BoardPage: ...

    def row(self, digest: str) -> Row: ...

    def method(self, method: str, team: str | None = None) -> list[Row]: ...

    def methods(self) -> list[tuple[str, str, int]]: ...

    def sequence_means(self, digest: str) -> dict[str, dict[str, float | None]]: ...

    def problems(self) -> dict[str, str]: ...


@dataclass(frozen=True)
class Literature:
    """A result reported by others on other data: never ranked with ours.

    metric: in words, as its source defines it; data: what it was measured on; source: where it was published
    """

    track: str
    method: str
    metric: str
    value: str
    data: str
    source: str
    url: str = ""
    note: str = field(default="")
