"""Rescoring of kept estimates with a new evaluator. Records are appended, each superseding the one it was made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from oysterbench.core.errors import OysterbenchError, ResultError, TrajectoryError
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.hub.canonical import sha256
from oysterbench.results.records import ResultRecord, now
from oysterbench.version import VERSION
from oysterbench_leaderboard.publishing.folders import folders_here, without_folders
from oysterbench_leaderboard.publishing.hidden import COSTS, discreet, is_hidden
from oysterbench_leaderboard.storage.curves import curves_document, sequence_curve
from oysterbench_leaderboard.storage.record import Record


@dataclass(frozen=True)
class Again:
    """Outcome of rescoring one record. record: None if it could not be rescored, with the reason in `why`; curves: to
    be stored with it, where the split is public."""

    old: str
    record: Record | None
    why: str = ""
    curves: dict[str, Any] | None = None


def is_outdated(record: Record) -> bool:
    """Whether a record was scored by another evaluator, or with other settings; False for tracks that cannot be
    rescored."""
    from oysterbench_leaderboard.submissions.catalogue import SCORED
    from oysterbench_leaderboard.submissions.scoring import evaluator

    if record.track not in SCORED:
        return False
    version, settings = evaluator(record.track)
    return record.evaluator_version != version or dict(record.results[0].settings) != settings


def score_again(
    record: Record,
    estimates: Path,
    truth: Path | None,
    reason: str,
    recipe: str | None = None,
    server: Path | None = None,
) -> Again:
    """Rescore the estimates that a record was made from.

    estimates: folder of files named by their SHA-256; truth: folder with the sequences of a hidden split; recipe: of
    the split, if it is not shipped with oysterbench; server: private folder of the server that received the uploads, by
    default the one that holds `estimates`

    Uploads are read and scored in a sandbox, as when they were submitted, within the limits of the settings.toml in the
    server's private folder, which the process cannot open. Nothing is written but the names of images, there or beside
    the uploads.
    """
    if not record.estimates:
        return Again(record.digest, None, "its estimates were not kept")
    try:
        files = {digest: _file(estimates, digest) for digest in set(record.estimates.values())}
        if record.tier == "scored":
            results, data_set, curves = _score_upload(record, files, truth, recipe or record.split, server)
        else:
            truths = _truths(record, truth, recipe or record.split)
            results, data_set, curves = _score_paths(record, files, truths)
            if is_hidden(record.results, recipe):
                told, data_set = discreet(results)
                results = tuple(told)
            here = folders_here(estimates)
            results = tuple(without_folders(result, here) for result in results)
    except OysterbenchError as error:
        return Again(record.digest, None, str(error))
    made = replace(
        record,
        results=results,
        data_set=data_set,
        curves="",
        supersedes=record.digest,
        reason=reason,
        created=now(),
    )
    return Again(record.digest, made, curves=curves)


def _file(folder: Path, digest: str) -> Path:
    path = folder / digest
    if not path.is_file():
        raise ResultError(f"its estimate {digest[:12]} is not in {folder}")
    if sha256(path.read_bytes()) != digest:
        raise ResultError(f"{path}: its bytes do not match its name: it was changed, and was not used")
    return path


Made = tuple[tuple[ResultRecord, ...], Mapping[str, Any] | None, dict[str, Any] | None]
"""Results, values over all sequences together, and curves."""


def _score_upload(
    record: Record, files: Mapping[str, Path], truth: Path | None, split: str, server: Path | None
) -> Made:
    """Score a team's upload, one file, in the same sandbox as when it was submitted."""
    from oysterbench_leaderboard.submissions.catalogue import serve_split
    from oysterbench_leaderboard.submissions.sandbox import sandbox
    from oysterbench_leaderboard.submissions.settings import is_server, load_settings

    if len(files) > 1:
        raise ResultError(f"expected one upload, got {len(files)} files")
    ((digest, path),) = files.items()
    above = path.absolute().parent.parent
    settings = load_settings(server or above)
    # The folder above a mere copy of the uploads is no server's, and may hold our own code, which the sandbox reads.
    private = [folder for folder in dict.fromkeys((settings.folder, above)) if is_server(folder)]
    served = serve_split(split, truth, (private[0] if private else path.parent) / "catalogue")
    wanted = served.wanted[record.track]
    _check_recipe(record, wanted.split_digest)
    if not served.truth:
        raise ResultError(f"{record.split} is not rendered here: `oysterbench render {record.split}`")
    truths = {name: str(place.resolve()) for name, place in served.truth.items()}
    folders = {path.parent, *private, *(place.parent for place in served.truth.values())}
    hidden = tuple(sorted(str(folder.resolve()) for folder in folders))
    job = sandbox.Job(str(path.resolve()), wanted, settings.limits, hidden, truths, record.method, record.created)
    ended = sandbox.run(job, sandbox.scoring(settings))
    if ended.answer is None:
        raise ResultError(f"scoring {digest[:12]} ended without an answer ({ended.cause})")
    if "refused" in ended.answer:
        raise ResultError(f"{digest[:12]} is refused now: {ended.answer['refused']['reason']}")
    results = tuple(ResultRecord.from_dict(values) for values in ended.answer["results"])
    return results, ended.answer["data_set"], ended.answer["curves"]


def _truths(record: Record, folder: Path | None, recipe: str) -> dict[str, Trajectory]:
    """Sequence -> true path, for the sequences of a record that have an estimate. Raises ResultError where the split is
    of another recipe or not rendered."""
    from oysterbench.recipe import load_split
    from oysterbench.sequence import open_sequence
    from oysterbench.simulation.generate import digest, sequence_files, split_folder

    split = load_split(recipe)
    _check_recipe(record, digest(split))
    files = sequence_files(split, folder or split_folder(split))
    wanted = {name.rpartition("/")[0] for name in record.estimates}
    for name in sorted(wanted):
        if not files[name].is_file():
            raise ResultError(f"{files[name]} is not there: `oysterbench render {record.split}`, or --truth FOLDER")
    return {name: open_sequence(files[name]).truth() for name in sorted(wanted)}


def _check_recipe(record: Record, here: str) -> None:
    if record.split_digest != here:
        raise ResultError(
            f"it is of another recipe of {record.split} ({record.split_digest[:12]}) than the one here ({here[:12]})"
        )


def _score_paths(record: Record, files: Mapping[str, Path], truths: Mapping[str, Trajectory]) -> Made:
    """Score kept paths, one file per run; a run without a path counts as failed, and costs stay as measured."""
    from oysterbench.evaluate.slam.scoring import SlamSettings, score
    from oysterbench_leaderboard.submissions.catalogue import KIND_OF
    from oysterbench_leaderboard.submissions.scoring import evaluator

    if KIND_OF.get(record.track) != "poses":
        raise ResultError(f"expected paths, got estimates of the track {record.track}; run the method again")
    version, settings = evaluator(record.track)
    results: list[ResultRecord] = []
    curves: dict[str, Any] = {}
    for old in record.results:
        common: dict[str, Any] = {"evaluator_version": version, "settings": settings, "oysterbench_version": VERSION}
        digest = record.estimates.get(f"{old.sequence}/{old.run + 1}")
        if digest is None:
            results.append(_unscored(old, old.failure or "its estimate was not kept", common))
            continue
        try:
            found = score(truths[old.sequence], read_trajectory(files[digest]), SlamSettings())
        except TrajectoryError as error:
            results.append(_unscored(old, str(error), common))
            continue
        costs = {key: old.metrics[key] for key in COSTS if key in old.metrics}
        results.append(
            replace(
                old,
                metrics={**found.metrics, **costs},
                reasons={**found.reasons, **{key: old.reasons[key] for key in costs if key in old.reasons}},
                failure=None,
                notes=found.notes,
                **common,
            )
        )
        curves.setdefault(old.sequence, sequence_curve(found, old.run))
    shown = curves_document(curves, settings["align"]) if curves and record.curves else None
    return tuple(results), None, shown


def _unscored(old: ResultRecord, failure: str, common: dict[str, Any]) -> ResultRecord:
    costs = {key: old.metrics[key] for key in COSTS if key in old.metrics}
    return replace(
        old, metrics=costs, reasons={k: v for k, v in old.reasons.items() if k in costs}, failure=failure, **common
    )
