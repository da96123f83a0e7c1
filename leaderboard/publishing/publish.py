"""Making records for the board from the output of `oysterbench run` and `oysterbench eval`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import RecipeError, ResultError, TrajectoryError
from oysterbench.core.names import listed
from oysterbench.core.text import composed
from oysterbench.evaluate.metrics import FAILED
from oysterbench.hub.canonical import sha256
from oysterbench.results.plausible import check_plausible
from oysterbench.results.records import ResultRecord, aggregate, comparable_key, method_key, read_results
from oysterbench.results.standings import PRIMARY
from oysterbench_leaderboard.boards.ranking import Claim, states, withdrawn
from oysterbench_leaderboard.publishing.folders import folders_here, without_folders
from oysterbench_leaderboard.publishing.hidden import discreet, is_hidden
from oysterbench_leaderboard.publishing.truths import other_truth
from oysterbench_leaderboard.storage.curves import curves_document, sequence_curve
from oysterbench_leaderboard.storage.record import RANKED, Record, Tier
from oysterbench_leaderboard.storage.store import RecordStore

SAME, SAME_SCALED = 1e-6, 5e-3
"""Tolerances between a recomputed score and the one in the results. SAME_SCALED is for a path whose scale is fitted: it
was fitted in the estimated frame, which a file of body poses no longer tells."""

Notify = Callable[[str], None]
"""Called with a sentence for the user."""

Drawn = tuple[Record, dict[str, Any] | None]
"""A record, and the curves to be drawn on its page, if any."""


@dataclass(frozen=True)
class Attribution:
    """Who is responsible for a record, how its method is described, and why it replaces earlier results."""

    team: str
    tier: Tier
    url: str = ""
    summary: str = ""
    reason: str = ""


def records_of(
    path: Path, by: Attribution, notify: Notify = lambda text: None, recipe: str | None = None
) -> list[Drawn]:
    """Make records from a results.json, or a folder with one, each with the curves for its page, if any.

    There is one for each method and split, in order of first appearance. Curves are made from the paths that
    `oysterbench run` left beside the results; hidden splits have none, and only few metrics (`hidden.discreet`).
    recipe: .toml file of a split that is not shipped with oysterbench. Raises ResultError, in one line, where results
    are of no split, or of one that may be hidden for all that is known, or those of a method may not be averaged.
    """
    path = path / "results.json" if path.is_dir() else path
    results = read_results(path)
    data_sets = _data_sets(path)
    groups: dict[tuple[str, str], list[ResultRecord]] = {}
    for result in results:
        groups.setdefault((result.method, result.split), []).append(result)
    if not groups:
        raise ResultError(f"{path}: holds no result; expected what `oysterbench run` or `oysterbench eval` writes")
    recipes = {} if recipe is None else {_name(recipe): recipe}
    if lacking := recipes.keys() - {split for _, split in groups}:
        raise ResultError(f"{path}: expected results on {lacking.pop()}, the split of {recipe}, got none")
    found = []
    for (method, split), group in groups.items():
        _check(path, method, split, group)
        source = recipes.get(split, split)
        hidden = is_hidden(group, source)
        if hidden is None:
            raise ResultError(
                f"{path}: neither the results on {split} nor this version say whether the split is hidden, so whether "
                "their numbers may be published: name its recipe with --split FILE.toml, or evaluate again"
            )
        known = _recipe(source, group[0], notify)
        if known is not None:
            _check_sequences(path, method, group, known, notify)
        data_set = data_sets.get(method)
        curves = _curves(path.parent, method, group, notify) if known is not None and not hidden else None
        if hidden:
            group, data_set = discreet(group, data_set)
        here, topics, name = folders_here(path.parent), _topics(known), composed(method)
        group = [replace(result, method=name) for result in group]
        if data_set is not None and "method" in data_set:
            data_set = {**data_set, "method": name}
        record = Record(
            method=name,
            team=composed(by.team),
            tier=by.tier,
            results=tuple(without_folders(result, here, topics) for result in group),
            url=by.url,
            summary=by.summary,
            data_set=data_set,
            manifest=_manifest(known),
            reason=by.reason,
            created=max(result.created for result in group),
        )
        found.append((record, curves))
    return found


def publish(store: RecordStore, records: Iterable[Drawn]) -> list[tuple[Record, str, bool]]:
    """Store records, each superseding the current one of its method, team and board; return them with their digests,
    and whether they are new: identical results are stored once. Raises ResultError, and stores nothing, where a
    reported record would supersede a ranked one, or the ground truth of one is not that of the board."""
    with store.publishing():
        return _publish(store, list(records))


def _publish(store: RecordStore, given_records: Sequence[Drawn]) -> list[tuple[Record, str, bool]]:
    done = []
    if why := other_truth(store, [record for record, _ in given_records]):
        raise ResultError(why)
    for record, _ in given_records:
        if ranked := ranked_instead(store, record):
            raise ResultError(
                f"{record.method} by {record.team} on {record.split} has a {store.record(ranked).tier} record, "
                f"{ranked[:8]}, which a reported one does not replace: give another --team, or take it off first: "
                f'`oysterbench leaderboard withdraw {ranked[:8]} --reason "..."`'
            )
    for given, curves in given_records:
        record = given if curves is None else replace(given, curves=store.add_curves(curves))
        before = store.records_by(record.team, record.method)
        earlier = [(digest, one) for digest, one in before if one.board == record.board]
        same = next((digest for digest, one in earlier if one.results == record.results and _text(one, record)), None)
        if same is not None:
            done.append((store.record(same), same, False))
            continue
        named = {one.supersedes for _, one in earlier}
        last = max((pair for pair in earlier if pair[0] not in named), key=lambda p: (p[1].created, p[0]), default=None)
        if last is not None:
            record = replace(record, supersedes=last[0])
        done.append((record, store.add(record), True))
    return done


def ranked_instead(store: RecordStore, record: Record) -> str:
    """Digest of the current ranked record that a reported one would supersede; empty where there is none. Anybody can
    write numbers down, so they must not take the place of scored ones."""
    if record.tier in RANKED:
        return ""
    earlier = store.records_by(record.team, record.method)
    claims = [Claim.of(digest, one) for digest, one in earlier]
    state = states(claims, withdrawn(store.read_status_changes()[0]))
    current = (digest for digest, one in earlier if one.board == record.board and one.tier in RANKED)
    return next((digest for digest in current if state[digest] == "current"), "")


def _text(one: Record, other: Record) -> bool:
    keys = ("tier", "url", "summary", "curves", "data_set", "manifest")
    return all(getattr(one, key) == getattr(other, key) for key in keys)


def _check(path: Path, method: str, split: str, group: Sequence[ResultRecord]) -> None:
    first = group[0]
    if not split:
        raise ResultError(
            f"{path}: the results of {method} belong to no split, but a board needs one; run the method on a split: "
            "`oysterbench run METHOD --split SPLIT`"
        )
    if first.track not in PRIMARY:
        raise ResultError(f"{path}: the track {first.track!r} has no board; there are: {', '.join(PRIMARY)}")
    for key, what in ((comparable_key, "recipes, evaluators or settings of these"), (method_key, "settings")):
        if len({key(result) for result in group}) > 1:
            raise ResultError(
                f"{path}: the results of {method} on {split} come from several {what} and would be averaged; put them "
                "in separate files"
            )
    for result in group:
        check_plausible(result, f"{path}: {method} on {result.sequence}")
    aggregate(group)  # raises where results cannot be averaged


def _name(recipe: str) -> str:
    from oysterbench.recipe import load_split

    return load_split(recipe).name


def _recipe(split: str, result: ResultRecord, notify: Notify) -> Any:
    """Return the recipe of a split, given by name or file; None, and notify the user, where the split is unknown or the
    results are of another recipe."""
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import digest

    try:
        recipe = load_split(split)
    except RecipeError:
        notify(f"{split} is not a split of this version: its sequences were not checked, and no paths are drawn")
        return None
    if digest(recipe) != result.split_digest:
        notify(
            f"the results are of another recipe of {recipe.name} ({result.split_digest[:12]}) than the one here "
            f"({digest(recipe)[:12]}): they go on a separate board, and no paths are drawn"
        )
        return None
    return recipe


def _topics(recipe: Any) -> set[str]:
    """Topics of all sequences of a split; none where it is unknown."""
    from oysterbench.simulation.jobs import wanted_topics

    return set() if recipe is None else {topic for one in recipe.sequence for topic in wanted_topics(recipe, one)}


def _check_sequences(path: Path, method: str, group: Sequence[ResultRecord], recipe: Any, notify: Notify) -> None:
    names = [sequence.name for sequence in recipe.sequence]
    answered = {result.sequence for result in group}
    if odd := sorted(answered - set(names)):
        raise ResultError(f"{path}: {method} has results on {listed(odd)}, which {recipe.name} does not have")
    if lacking := [name for name in names if name not in answered]:
        notify(f"{method} has no result on {', '.join(lacking)} of {recipe.name}: these count as failed")


def _manifest(recipe: Any) -> str:
    """SHA-256 of the released manifest; empty where there is none."""
    if recipe is None:
        return ""
    from oysterbench.hub.manifest import released_manifest

    manifest = released_manifest(recipe.name, recipe.version)
    return "" if manifest is None else manifest.sha256


def _data_sets(path: Path) -> dict[str, Any]:
    """Method -> values over all sequences together, from a results.json."""
    rows = json.loads(path.read_text(encoding="utf-8")).get("data_set") or []
    return {row["method"]: row for row in rows if isinstance(row, dict) and "method" in row}


def keep_estimates(record: Record, folder: Path, estimates: Path) -> Record:
    """Copy the paths beside a record's results to `estimates`, named by their SHA-256, for rescoring; return the record
    with their digests.

    folder: of the results; estimates: private, as paths on hidden splits would reveal the ground truth
    """
    runs: dict[str, int] = {}
    for result in record.results:
        runs[result.sequence] = runs.get(result.sequence, 0) + 1
    named = {}
    for result in record.results:
        path = _estimate(folder, record.method, result, runs[result.sequence])
        if result.failure is None and path.is_file():
            data = path.read_bytes()
            named[f"{result.sequence}/{result.run + 1}"] = sha256(data)
            write_atomically(estimates / sha256(data), data)
    return replace(record, estimates=named)


def _estimate(folder: Path, method: str, result: ResultRecord, runs: int) -> Path:
    """File in which `oysterbench run` left the path of a result. runs: number of runs on its sequence."""
    number = f"-{result.run + 1}" if runs > 1 else ""
    return folder / f"{result.sequence}-{method}{number}.tum"


def _curves(folder: Path, method: str, group: Sequence[ResultRecord], notify: Notify) -> dict[str, Any] | None:
    """Curves of each sequence, from the run with the median score; None where no paths are beside the results."""
    of_sequence: dict[str, list[ResultRecord]] = {}
    for result in group:
        of_sequence.setdefault(result.sequence, []).append(result)
    curves = {}
    for name, runs in of_sequence.items():
        scored = [run for run in runs if run.failure is None]
        if not scored:
            continue
        order = sorted(scored, key=lambda run: (run.metrics.get(PRIMARY[run.track], np.nan), run.run))
        median = order[(len(order) - 1) // 2]
        estimate, truth = _estimate(folder, method, median, len(runs)), folder / f"{name}-truth.tum"
        if not estimate.is_file() or not truth.is_file():
            continue
        try:
            curves[name] = _curve(truth, estimate, median)
        except TrajectoryError as error:
            notify(f"{estimate}: no path is drawn: {error}")
    return curves_document(curves, str(group[0].settings["align"])) if curves else None


def _curve(truth: Path, estimate: Path, result: ResultRecord) -> dict[str, Any]:
    from oysterbench.core.trajectory import read_trajectory
    from oysterbench.evaluate.slam.scoring import score
    from oysterbench.evaluate.slam.settings import SCALED

    found = score(read_trajectory(truth), read_trajectory(estimate), slam_settings(result.settings))
    scaled = result.settings["align"] in SCALED
    for key in FAILED[result.track]:
        if abs(found.metrics[key] - result.metrics[key]) > (SAME_SCALED if scaled else SAME):
            # The worse a path, the more does a scale fitted to its body poses differ from that of the estimated ones.
            lost = ", or so far from the ground truth that its scale is uncertain" if scaled else ""
            raise TrajectoryError(
                f"its {key} is {found.metrics[key]:.6g}, and that of the results {result.metrics[key]:.6g}: it is of "
                f"another run or another evaluator{lost}"
            )
    return sequence_curve(found, result.run)


def slam_settings(values: Mapping[str, Any]) -> Any:
    """Evaluator settings made from those of a result. Raises TrajectoryError where they are of another evaluator."""
    from oysterbench.evaluate.slam.scoring import SlamSettings

    given: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    try:
        return SlamSettings(**given)
    except TypeError as error:
        raise TrajectoryError(f"the settings are of another evaluator ({error})") from None
