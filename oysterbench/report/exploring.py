"""Tables of the steering track: all images together, and the position of a policy between two others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from oysterbench.core.html import capital
from oysterbench.evaluate.runs import span_of_runs
from oysterbench.evaluate.statistics import Interval, compare
from oysterbench.evaluate.steering.dataset import Constant, Whole, over_sequences, together
from oysterbench.evaluate.steering.metrics import STEERING
from oysterbench.evaluate.steering.rollouts import NormalisedScore, normalised_score
from oysterbench.recipe import SteeringRecipe
from oysterbench.report.columns import metric_column, metric_columns, name_columns
from oysterbench.report.steering import PictureRun, RolloutRun
from oysterbench.report.table import MINUS, Cell, Column, Table, TableRow, interval_column
from oysterbench.report.tables import difference_column
from oysterbench.results.records import ResultRecord, samples

INTERVALS = ("yaw_macro_f1", "pitch_macro_f1")
"""Metrics over all images that are shown with their interval."""

OF_PAIRS = ("oysters_per_min", "covered_share", "contacts_per_min")
"""Metrics that policies are compared by, each on the same reefs."""

CONSTANT = "best constant"
"""Row of the best command that never changes, which shows what images add."""

LOWER, UPPER = "random", "expert"
"""The policies between which the others are placed."""


def whole_of(runs: Sequence[PictureRun]) -> dict[str, Whole]:
    """Score each method over all images together, if it failed on no sequence, and lacks none that others ran on: where
    it was killed, there is no record."""
    groups: dict[str, dict[str, list[PictureRun]]] = {}
    for run in runs:
        groups.setdefault(run.record.method, {}).setdefault(run.record.sequence, []).append(run)
    every = {run.record.sequence for run in runs}
    found = {}
    for method, sequences in groups.items():
        if sequences.keys() != every:
            continue
        parts = [
            [(run.labels, run.commands) for run in group if run.labels is not None and run.commands is not None]
            for group in sequences.values()
        ]
        counts = [len(group) for group in sequences.values()]
        if [len(part) for part in parts] == counts:
            found[method] = over_sequences([together(part) for part in parts], counts)
    return found


def pictures_table(wholes: Mapping[str, Whole], constant: Constant | None, task: SteeringRecipe) -> Table:
    """Table with a row per method over all images together, for metrics that are means or counts over images, and one
    of the best constant answer, if there is one. Skill is left out: everywhere, in standings, ranks and on boards, that
    of a method is the mean over its sequences; a note gives that of the best constant answer."""
    columns = list(name_columns("method"))
    for column in metric_columns(key for key in STEERING.table if key != "skill"):
        columns += [column, interval_column(column)] if column.key in INTERVALS else [column]
    rows = []
    for method, whole in {**wholes, **({CONSTANT: constant.whole} if constant is not None else {})}.items():
        values = [whole.score.metrics.get(c.key) if c.kind == "number" else _interval(whole, c) for c in columns[1:]]
        rows.append(TableRow((method, *values)))
    notes = []
    for whole in list(wholes.values())[:1]:
        n, pictures = whole.sequences, whole.score.metrics["pictures"]
        about = f"{pictures:.0f} images of {n} sequence{'' if n == 1 else 's'} together"
        about += f", in {span_of_runs(whole.runs)} on each" if max(whole.runs) > 1 else ""
        reason = whole.intervals[INTERVALS[0]].reason
        notes.append(f"{about}; {reason or 'sequences are resampled for the interval'}.")
    if constant is not None:
        notes.append(
            f"{CONSTANT}: {_in_words(constant.classes, task)} at every image has a skill of {constant.skill:.3f}"
            f"{', the mean over sequences' if constant.whole.sequences > 1 else ''}. It is the command with the "
            "highest skill on these very sequences: an upper bound for answers that never change."
        )
    return Table("Over all images", tuple(columns), tuple(rows), tuple(notes))


def _in_words(classes: tuple[int, int], task: SteeringRecipe) -> str:
    """A command, such as "30 deg right, 8 deg down"."""
    yaw, pitch = task.yaw_deg[classes[0]], task.pitch_deg[classes[1]]
    turns = [f"{abs(yaw):g} deg {'left' if yaw > 0 else 'right'}"] if yaw else []
    turns += [f"{abs(pitch):g} deg {'down' if pitch > 0 else 'up'}"] if pitch else []
    return ", ".join(turns) or "straight on"


def _interval(whole: Whole, column: Column) -> Interval:
    return whole.intervals[column.key.removesuffix("_interval")]


def _policies(runs: Sequence[RolloutRun]) -> dict[str, list[ResultRecord]]:
    found: dict[str, list[ResultRecord]] = {}
    for run in runs:
        found.setdefault(run.record.method, []).append(run.record)
    return found


def policies_table(runs: Sequence[RolloutRun]) -> Table:
    """Table of every policy against each later one: differences in several metrics on the same reefs."""
    policies = _policies(runs)
    names = list(policies)
    rows = []
    for key in OF_PAIRS:
        usual = difference_column(metric_column(key))
        better: Literal["lower", "higher"] = "lower" if metric_column(key).better == "lower" else "higher"
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                found = compare(samples(policies[a], key), samples(policies[b], key), better)
                column = usual.resolving([found.interval])
                values = (
                    f"{a} {MINUS} {b}",
                    f"{metric_column(key).heading} [{column.unit}]",
                    Cell(found.difference, column.text(found.difference)),
                    Cell(found.interval, column.text(found.interval)),
                    Cell(text=f"{found.wins} / {found.ties} / {found.losses}"),
                    found.verdict if found.interval.known else "too few reefs to tell",
                )
                rows.append(TableRow(values))
    difference = Column("difference", "Difference", kind="number", short="difference")
    reefs = Column("won_tied_lost", "Reefs", "won / tied / lost", "number", "reefs")
    columns = (
        *name_columns("policies", "metric"),
        difference,
        interval_column(difference),
        reefs,
        *name_columns("verdict"),
    )
    return Table("Policy against policy", columns, tuple(rows))


def places(runs: Sequence[RolloutRun]) -> dict[str, NormalisedScore]:
    """Position of each policy between LOWER and UPPER, by oysters per minute; empty if one of these is missing."""
    policies = {name: samples(records, "oysters_per_min") for name, records in _policies(runs).items()}
    if LOWER not in policies or UPPER not in policies:
        return {}
    return {
        name: normalised_score(sample, policies[LOWER], policies[UPPER])
        for name, sample in policies.items()
        if name not in (LOWER, UPPER)
    }


def places_table(found: Mapping[str, NormalisedScore]) -> Table:
    """Table with a row per policy and its position."""
    place = Column("place", "Place", f"{LOWER} 0, {UPPER} 1", "number", "place", digits=2)
    rows = [TableRow((name, where.value, where.interval, where.reefs)) for name, where in found.items()]
    columns = (
        *name_columns("policy"),
        place,
        interval_column(place),
        Column("reefs", "Reefs", kind="number", short="reefs"),
    )
    reasons = dict.fromkeys(where.reason or where.interval.reason for where in found.values())
    formula = f"(policy {MINUS} {LOWER}) / ({UPPER} {MINUS} {LOWER})"
    notes = [f"{formula}, from the mean oysters per minute on the same reefs."]
    notes += [f"{capital(reason)}." for reason in reasons if reason]
    return Table(f"Place between {LOWER} and {UPPER}", columns, tuple(rows), tuple(notes))
