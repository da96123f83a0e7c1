"""What a client sends: found in a file or folder, packed into one file, and checked before it is sent."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.core.locks import scratch
from oysterbench.core.names import did_you_mean, listed, nearest
from oysterbench.core.text import read_json
from oysterbench.recipe.steering import SteeringRecipe
from oysterbench_leaderboard.submissions.catalogue import Wanted, local_wanted
from oysterbench_leaderboard.submissions.reading.archive import Limits, pack
from oysterbench_leaderboard.submissions.reading.predictions import IMAGE, OPENERS, check_predictions, open_upload

RESULTS = "results.json"
KINDS = {".zip": "application/zip", ".json": "application/json", ".txt": "text/plain", ".tum": "text/plain"}
KINDS |= {".csv": "text/csv", ".npz": "application/octet-stream"}
"""Suffix of a file that is sent as it is -> its content type."""

SUFFIXES = tuple(dict.fromkeys(suffix for openers in OPENERS.values() for suffix in openers if suffix != IMAGE))
"""Suffixes of files named by a sequence."""

OF_A_SEQUENCE = (".tum", ".txt", ".csv")
"""Suffixes of files that each hold a single sequence."""

NO_RATIO = 1e9  # the client's own files need no limit on their compression ratio


@dataclass(frozen=True)
class Package:
    """A file to be sent. facts: what it holds (`check_predictions`)."""

    path: Path
    content_type: str
    digest: str
    size: int
    wanted: Wanted
    facts: dict[str, Any]


@dataclass(frozen=True)
class Found:
    """What is to be sent: one file, or several by their names in an archive. others: names of further files there that
    match no sequence, and are not sent. runs: numbers of the runs of which there are estimates; one of them is sent.
    failed: numbers of those that have results, but no estimates. scored: whether there are results."""

    file: Path | None
    files: dict[str, Path]
    others: tuple[str, ...] = ()
    runs: tuple[int, ...] = ()
    failed: tuple[int, ...] = ()
    scored: bool = False

    @property
    def names(self) -> list[str]:
        """Names of the sequences that the file names refer to, sorted."""
        return sorted({name.split("/")[0].rpartition(".")[0] or name.split("/")[0] for name in self.files})


def find_package(place: Path, sequences: Sequence[str], method: str = "", run: int = 1, results: bool = False) -> Found:
    """Find what a path holds for these sequences: a file; a folder with a file or an image folder for each sequence; or
    the output of `oysterbench run` and `eval`. method, run: which of the estimates in that output. results: send its
    results.json instead. Raises ResultError."""
    if place.is_file():
        if place.suffix.lower() not in KINDS:
            raise ResultError(f"{place}: expected a file that ends in {', '.join(KINDS)}, got {place.suffix or 'none'}")
        if place.suffix in OPENERS["poses"] and place.stem in sequences and len(sequences) > 1:
            return Found(None, {place.name: place})
        if place.suffix in OF_A_SEQUENCE and len(sequences) > 1:
            meant = did_you_mean(nearest(place.stem, sequences)).strip()
            raise ResultError(
                f"{place}: its name is of no sequence of the split: expected SEQUENCE{place.suffix}, the sequences "
                f"being {listed(sequences)}" + (f"; {meant}" if meant else "")
            )
        return Found(place, {})
    if not place.is_dir():
        raise ResultError(f"{place}: no such file or folder; expected results.json, or estimates")
    if results:
        if not (place / RESULTS).is_file():
            raise ResultError(f"{place}: has no {RESULTS}; `oysterbench eval` writes it")
        return Found(place / RESULTS, {})
    files: dict[str, Path] = {}
    for sequence in sequences:
        own = [place / f"{sequence}{suffix}" for suffix in SUFFIXES]
        own = [path for path in own if _is_file(path)]
        if len(own) > 1:
            raise ResultError(f"{place}: both {own[0].name} and {own[1].name} are of {sequence}; keep one of them")
        if own:
            files[own[0].name] = own[0]
        elif (place / sequence).is_dir():
            images = sorted((place / sequence).rglob(f"*{IMAGE}"))
            files |= {path.relative_to(place).as_posix(): path for path in images}
        else:
            _is_file(place / sequence)  # a broken link to a folder of images is no sequence that failed
    runs: dict[int, dict[str, Path]] = {}
    if not files and (place / RESULTS).is_file():
        runs = _runs(place, sequences, method)
        made = [number for number, left in runs.items() if left]
        if not made:
            raise ResultError(
                f"{place}: no estimates there as a board reads them (SEQUENCE.tum or .csv, masks as "
                f"SEQUENCE/CAMERA/STAMP.png), only a {RESULTS}; add --results to send that, as reported"
            )
        files = runs.get(run, {})
        if not files:
            raise ResultError(
                f"{place}: no estimates of run {run}: it failed, or was not made; expected "
                f"{'one of ' if len(made) > 1 else ''}{listed(map(str, made))} (--run)"
            )
    if not files:
        first = sequences[0] if sequences else "SEQUENCE"
        raise ResultError(
            f"{place}: expected a file for each sequence, e.g. {first}.tum or {first}.csv, masks "
            f"{first}/CAMERA/STAMP.png, or what `oysterbench run` leaves; found "
            f"{listed(sorted(path.name for path in place.iterdir())).replace('none', 'an empty folder')}"
        )
    if run != 1 and not runs:
        raise ResultError(f"{place}: --run {run} chooses from what `oysterbench run` leaves; these files are of no run")
    of_run = (place / RESULTS).is_file()
    sent = {path.name for path in files.values()}
    others = [path.name for path in place.iterdir() if path.suffix in SUFFIXES and path.name not in sent]
    sendable, failed = (tuple(number for number, left in runs.items() if bool(left) == kept) for kept in (True, False))
    scored = bool(_first_result(place / RESULTS))
    return Found(None, files, () if of_run else tuple(sorted(others)), sendable, failed, scored)


def _is_file(path: Path) -> bool:
    """Whether there is a file; False where there is nothing of that name. Raises ResultError for anything else, which
    would be taken for a sequence that failed."""
    if path.is_file() or not os.path.lexists(path):
        return path.is_file()
    what = "a folder" if path.is_dir() else "something that is no file"
    if path.is_symlink() and not path.exists():
        what = f"a broken link, to {os.readlink(path)}"
    raise ResultError(f"{path}: expected estimates, got {what}; mend it, or remove it to send none for the sequence")


def _runs(place: Path, sequences: Sequence[str], method: str) -> dict[int, dict[str, Path]]:
    """Find the estimates of a method in the output of `oysterbench run`: number of a run -> the files that it left, by
    the names they are sent under; none where it failed, whatever an earlier run left there.

    Where there are results on a sequence, they say which runs there are. On sequences without ground truth there are
    none, and the files do.
    """
    from oysterbench.results.records import read_results

    records = read_results(place / RESULTS)
    methods = list(dict.fromkeys(record.method for record in records))
    if not any(record.sequence in sequences for record in records):
        methods = [name for name in _methods_run(place) if any(_left(place, one, name) for one in sequences)] or methods
    if not methods and not method:
        raise ResultError(
            f"{place / RESULTS}: expected results of a method, found none; name the files SEQUENCE.tum, or the method "
            "that they are of (--of NAME)"
        )
    if not method and len(methods) > 1:
        raise ResultError(f"{place} has results of {', '.join(methods)}; say whose estimates to send (--of NAME)")
    chosen = method or methods[0]
    if methods and chosen not in methods:
        raise ResultError(f"{place}: no results of {chosen!r}; it has those of {', '.join(methods)} (--of NAME)")
    runs: dict[int, dict[str, Path]] = {}
    for sequence in sequences:
        failed = {one.run + 1: bool(one.failure) for one in records if (one.method, one.sequence) == (chosen, sequence)}
        files = {n: _estimate(place, sequence, chosen, n, len(failed)) for n in failed}
        for number, file in (files or _left(place, sequence, chosen)).items():
            left = runs.setdefault(number, {})
            if not failed.get(number) and not _has_failed(place, sequence, chosen, number) and _is_file(file):
                left[f"{sequence}.tum"] = file
    return dict(sorted(runs.items()))


def _methods_run(place: Path) -> list[str]:
    """Names of the methods that `oysterbench run` ran with its output here."""
    return sorted(path.name for path in (place / "runs").glob("*") if path.is_dir())


def _estimate(place: Path, sequence: str, method: str, number: int, runs: int) -> Path:
    """File in which `oysterbench run` leaves the path of a run; runs: their number."""
    return place / f"{sequence}-{method}{f'-{number}' if runs > 1 else ''}.tum"


def _has_failed(place: Path, sequence: str, method: str, number: int) -> bool:
    """Whether the folder that `oysterbench run` keeps of a run says that it failed, or never ended."""
    from oysterbench.methods.outcomes import read_outcome

    folder = place / "runs" / method / sequence / f"{number}"
    if not folder.is_dir():
        return False
    outcome = read_outcome(folder)
    return outcome is None or outcome.failure is not None


def _left(place: Path, sequence: str, method: str) -> dict[int, Path]:
    """Number of a run -> its path, by the files alone. Raises ResultError where they are of several commands."""
    plain, begin = _estimate(place, sequence, method, 1, 1), f"{sequence}-{method}-"
    ends = {path.stem.removeprefix(begin): path for path in place.glob("*.tum") if path.stem.startswith(begin)}
    others = _methods_run(place)  # a method may be named like the run of another
    found = {int(end): path for end, path in ends.items() if end.isdecimal() and f"{method}-{end}" not in others}
    if not _is_file(plain):
        return found
    if found:
        names = f"{plain.name} and {found[min(found)].name}"
        raise ResultError(f"{place}: {names} are of different commands; remove those that are not to be sent")
    return {1: plain}


def split_in(place: Path) -> tuple[str, str]:
    """Split and track of a results.json, or of the one in a folder; empty where there is none."""
    path = place / RESULTS if place.is_dir() else place
    found = _first_result(path) if path.name.endswith(".json") and path.is_file() else {}
    return str(found.get("split", "")), str(found.get("track", ""))


def _first_result(path: Path) -> dict[str, Any]:
    """First row of a results.json, unchecked; empty where the file is not one."""
    try:
        return dict(read_json(path.read_bytes())["results"][0])
    except (OSError, ValueError, LookupError, TypeError):
        return {}


def wanted_of(split: str, track: str, known: dict[str, Any]) -> Wanted:
    """What the split requires, as this installation knows it, or else as the server describes it in `known`."""
    spans = {name: (int(begin), int(end)) for name, (begin, end) in known.get("spans", {}).items()}
    counts = {name: int(count) for name, count in known.get("images", {}).items()}
    try:
        return replace(local_wanted(split, track), counts=counts, spans=spans)
    except OysterbenchError:
        task = msgspec.convert(known.get("task"), SteeringRecipe | None)
        names = tuple(known["sequences"])
        return Wanted(track, split, "", bool(known["hidden"]), names, counts=counts, task=task, spans=spans)


@contextmanager
def packed(found: Found, wanted: Wanted, limits: dict[str, int]) -> Iterator[Package]:
    """Pack what was found into one file, and check it as the server will. Raises Refusal naming file and line, and
    ResultError where it is larger than the server accepts."""
    with scratch() as folder:
        if found.file is not None:
            path, kind = found.file, KINDS[found.file.suffix.lower()]
        else:
            path, kind = folder / "predictions.zip", KINDS[".zip"]
            with open(path, "wb") as target:
                pack(found.files, target)
        size = path.stat().st_size
        if size > limits["upload_bytes"]:
            most = limits["upload_bytes"] // 1_000_000
            raise ResultError(f"{path.name}: {size / 1e6:.0f} MB to send; the server takes at most {most} MB")
        within = Limits(limits["file_bytes"], limits["file_bytes"], 1 << 30, 1 << 40, NO_RATIO)
        known = wanted
        if not wanted.split_digest:  # then the digest is known from the results alone
            known = replace(wanted, split_digest=str(_first_result(path).get("split_digest", "")))
        facts = check_predictions(open_upload(path, known, within), known)
        with open(path, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        yield Package(path, kind, digest, size, wanted, facts)
