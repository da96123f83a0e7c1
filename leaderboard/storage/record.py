"""Record: the published results of one method on one split by one evaluator. Immutable, and named by its own hash."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime
from functools import cached_property
from typing import Any, Literal, get_args

from oysterbench.core.errors import ResultError
from oysterbench.core.text import compatible, disguised, mixed_word, unseen, web_host
from oysterbench.hub.canonical import SHA256, canonical, sha256
from oysterbench.results.records import ResultRecord, checked, comparable_key, now, plain

FORMAT = "oysterbench-record/1"

Tier = Literal["baseline", "scored", "reported"]
"""Who vouches for the numbers. baseline: run and scored by us, from this source tree; scored: estimates by others,
scored by a server against ground truth that they cannot have on a hidden split, and can make on a public one; reported:
results computed by their authors."""

TIERS: tuple[Tier, ...] = get_args(Tier)

RANKED: tuple[Tier, ...] = ("baseline", "scored")
"""Tiers that a board ranks: for these it is known that a program computed the numbers from an estimate."""

TIME = re.compile("2[0-9]{3}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}Z")
"""A time as records have it: UTC, of this millennium, and so sorted as text."""

MOST_TEXT = {"method": 80, "team": 80, "url": 300, "summary": 500, "reason": 500}
"""Key of a record -> maximum number of characters."""


@dataclass(frozen=True, kw_only=True)
class Record:
    """All results of a method on a split, as one evaluator scored them.

    method, team:  names for the board; url, summary: where the method is described, and one sentence about it
    tier:          who vouches for the numbers
    results:       one per sequence and run, of one method, split, evaluator and setting
    data_set:      values over all sequences together, for tracks that have them (`results.document`)
    manifest:      SHA-256 of the released manifest of the split; empty where none was released
    estimates:     "sequence/run" (runs from 1) -> SHA-256 of the estimate, where it is kept for rescoring
    curves:        SHA-256 of the paths and error curves to be drawn (`curves.py`); empty for hidden splits
    supersedes:    digest of the record that this one replaces; empty for none. reason: why
    created:       UTC, ISO 8601
    """

    method: str
    team: str
    tier: Tier
    results: tuple[ResultRecord, ...]
    url: str = ""
    summary: str = ""
    data_set: Mapping[str, Any] | None = None
    manifest: str = ""
    estimates: Mapping[str, str] = field(default_factory=dict)
    curves: str = ""
    supersedes: str = ""
    reason: str = ""
    created: str = field(default_factory=now)

    def __post_init__(self) -> None:
        object.__setattr__(self, "results", tuple(self.results))
        object.__setattr__(self, "estimates", dict(self.estimates))
        if self.tier not in TIERS:
            raise ResultError(f"record: key 'tier': expected one of {', '.join(TIERS)}, got {self.tier!r:.60}")
        for key, most in MOST_TEXT.items():
            check_text(key, getattr(self, key), most)
        if not self.method.strip() or not self.team.strip():
            raise ResultError("record: expected a name of the method and of the team, got an empty one")
        check_address(self.url)
        check_time("created", self.created)
        if not self.results:
            raise ResultError(f"record of {self.method}: expected results, got none")
        for key in ("manifest", "curves", "supersedes"):
            value = getattr(self, key)
            if value and not SHA256.fullmatch(value):
                raise ResultError(
                    f"record: key {key!r}: expected a SHA-256 (64 hex digits) or nothing, got {value!r:.80}"
                )
        keys = ("track", "split", "split_digest", "evaluator_version", "settings")
        first = [getattr(self.results[0], key) for key in keys]
        if any([getattr(result, key) for key in keys] != first for result in self.results):
            raise ResultError(
                f"record of {self.method}: expected results of one split, evaluator and setting, got several"
            )
        places = [(result.sequence, result.run) for result in self.results]
        if len(set(places)) < len(places):
            raise ResultError(f"record of {self.method}: expected each run of a sequence once, got one of them twice")
        truths = {(result.sequence, result.truth_digest) for result in self.results if result.truth_digest}
        if len({sequence for sequence, _ in truths}) < len(truths):
            raise ResultError(f"record of {self.method}: expected one ground truth of a sequence, got several")

    @property
    def track(self) -> str:
        return self.results[0].track

    @property
    def split(self) -> str:
        return self.results[0].split

    @property
    def split_digest(self) -> str:
        """Digest of the split's recipe."""
        return self.results[0].split_digest

    @property
    def evaluator_version(self) -> str:
        return self.results[0].evaluator_version

    @cached_property
    def board(self) -> str:
        """Id of the board, 16 hex digits: records whose numbers may be compared share track, split, recipe, evaluator
        and the evaluator's settings."""
        return sha256(canonical(list(comparable_key(self.results[0]))))[:16]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "results"}
        return {"format": FORMAT, **plain(values), "results": [result.to_dict() for result in self.results]}

    @cached_property
    def data(self) -> bytes:
        """The record as canonical JSON."""
        return canonical(self.to_dict())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of `data`, which is the record's name."""
        return sha256(self.data)

    @classmethod
    def from_dict(cls, values: Any, where: str = "record") -> Record:
        """Make a record from plain values. Raises ResultError naming `where` and the key."""
        if isinstance(values, Mapping) and isinstance(results := values.get("results"), list):
            read = [ResultRecord.from_dict(r, f"{where}: results[{i}]") for i, r in enumerate(results)]
            values = {**values, "results": read}
        return checked(values, cls, FORMAT, where)


def check_time(key: str, value: str) -> None:
    """Refuse a value that is not a time as `TIME`. Raises ResultError naming the key."""
    try:
        known = TIME.fullmatch(value) and datetime.fromisoformat(value)
    except ValueError:
        known = None
    if not known:
        raise ResultError(
            f"key {key!r}: expected a UTC time from 2000 to 2999, as 2026-11-01T12:00:00Z, got {value!r:.60}"
        )


def check_address(url: str) -> None:
    """Refuse an address of a method's description that cannot be opened; an empty one stands for none. Raises
    ResultError."""
    if url and not web_host(url):
        raise ResultError(
            f"record: key 'url': expected https://... with the name of a host, or nothing, got {url!r:.60}"
        )


def check_text(key: str, value: Any, most: int) -> None:
    """Refuse a value that is not plain text in one line of at most `most` characters; in names, also letters in
    disguise and words of mixed scripts. Raises ResultError naming the key."""
    if not isinstance(value, str):
        raise ResultError(f"record: key {key!r}: expected text, got {value!r:.60}")
    if len(value) > most:
        raise ResultError(f"record: key {key!r}: expected at most {most} characters, got {len(value)}")
    if (odd := unseen(value)) is not None:
        raise ResultError(f"record: key {key!r}: expected plain text in one line, got the character {odd!a}")
    if key in ("method", "team"):
        if (odd := disguised(value)) is not None:
            raise ResultError(f"record: key {key!r}: expected common letters, {compatible(odd)!r}, got {odd!a}")
        if (word := mixed_word(value)) is not None:
            raise ResultError(f"record: key {key!r}: expected words of one script, got {word!a}")
