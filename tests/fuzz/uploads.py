"""Uploads over all tracks that can be submitted, read and scored as the server's sandbox does both.

    python -m tests.fuzz.uploads --count 5000 --seed 1 --log uploads.jsonl

A case is a valid upload with changes that know its form. It is refused in a line, or scored with numbers that can be,
which become a record; and an upload that is valid scores after it, in the same process, what it scored before. Every
tenth case is read in a sandbox of its own besides, which has to say the same.
"""

from __future__ import annotations

import io
import json
import sys
import tempfile
import zipfile
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.streams import stream
from oysterbench.results.plausible import check_plausible
from oysterbench.results.records import ResultRecord, document
from oysterbench_leaderboard.publishing.hidden import STEP
from oysterbench_leaderboard.submissions.catalogue import Served
from oysterbench_leaderboard.submissions.database import Submission
from oysterbench_leaderboard.submissions.reading.predictions import open_upload
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.sandbox import sandbox
from oysterbench_leaderboard.submissions.sandbox.sandbox import Job
from oysterbench_leaderboard.submissions.sandbox.sandbox_worker import do
from oysterbench_leaderboard.submissions.scoring import score_predictions
from oysterbench_leaderboard.submissions.words import Form
from tests.fuzz.archives import archive, zipped
from tests.fuzz.mutations import BY_SUFFIX, VALUES, WORDS, one, raw
from tests.fuzz.mutations import document as changed_document
from tests.fuzz.watch import Wrong, tool
from tests.helpers.pool import IMAGES, NAMES, classes, estimate, image_names, lay_split, steered, tum
from tests.helpers.served import lay, make_service
from tests.helpers.submissions_read import as_coco, as_png, masks, npz, opened

CREATED = "2026-11-01T00:00:00Z"
SANDBOXED = 10
"""Every so many cases one is read in a sandbox of its own."""


@dataclass(frozen=True)
class Sample:
    """A valid upload: a file (with no name), or those of a zip archive."""

    split: str
    track: str
    files: dict[str, bytes]

    @property
    def whole(self) -> bytes:
        """The upload."""
        return self.files[""] if "" in self.files else zipped(list(self.files.items()))


def samples(served: dict[str, Served], folder: Path) -> dict[str, Sample]:
    """By kind: of each track, in each form that its predictions have."""
    paths = {name: estimate(k) for k, name in enumerate(NAMES)}
    both = {**masks(0), **masks(1)}
    commands = {f"{name}.csv": commands_of(k) for k, name in enumerate(NAMES)}
    probable = {f"{name}.csv": commands_of(k, True) for k, name in enumerate(NAMES)}
    found = {
        "paths, text": Sample("pool-test", "slam", {f"{name}.tum": tum(one, folder) for name, one in paths.items()}),
        "paths, public": Sample("pool-val", "slam", {f"{name}.txt": tum(one, folder) for name, one in paths.items()}),
        "paths, EuRoC": Sample("pool-test", "slam", {f"{name}.csv": euroc(one) for name, one in paths.items()}),
        "paths, arrays": Sample(
            "pool-test",
            "slam",
            {
                f"{name}.npz": npz(stamps_ns=one.stamps_ns, positions=one.positions, quaternions=one.quaternions)
                for name, one in paths.items()
            },
        ),
        "commands": Sample("pool-steer", "steering", commands),
        "commands, probable": Sample("pool-dive", "steering", probable),
    }
    for track in ("segmentation", "detection"):
        found |= {
            f"{track}, PNG": Sample("pool-masks", track, {f"{name}.png": as_png(mask) for name, mask in both.items()}),
            f"{track}, arrays": Sample(
                "pool-masks", track, {f"{name}.npz": npz(**masks(k)) for k, name in enumerate(NAMES)}
            ),
            f"{track}, probable": Sample(
                "pool-masks", track, {"": npz(**{name: mask * np.float32(0.7) for name, mask in both.items()})}
            ),
            f"{track}, COCO": Sample("pool-shapes", track, {"": as_coco(both)}),
        }
    for split, track, data in (
        ("pool-val", "slam", found["paths, text"].whole),
        ("pool-dive", "steering", found["commands"].whole),
        ("pool-shapes", "segmentation", found["segmentation, PNG"].whole),
        ("pool-shapes", "detection", found["segmentation, PNG"].whole),
    ):
        wanted = served[split].wanted[track]
        scored = score_predictions(opened(folder, data, wanted)[0], wanted, served[split].truth, "mine", CREATED)
        results = json.dumps(document(scored.results)).encode()
        found[f"{track}, results"] = Sample(split, track, {"": results})
    return found


def commands_of(sequence: int, probable: bool = False) -> bytes:
    """A table of commands, half of them right."""
    rows = ["stamp_ns,yaw,pitch"] if not probable else ["stamp_ns,yaw_0,yaw_1,yaw_2,pitch_0,pitch_1,pitch_2"]
    for k, name in enumerate(image_names(sequence)):
        axes = steered(sequence)[0][k % 2]
        given = [0.7 if i == c else 0.15 for c in axes for i in range(3)] if probable else axes.tolist()
        rows.append(",".join(map(str, (name.rpartition("/")[2], *given))))
    assert len(rows) == IMAGES + 1
    return "\n".join(rows).encode()


def euroc(path: Any) -> bytes:
    """A path in the layout of EuRoC."""
    head = "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z"
    numbers = zip(path.stamps_ns, path.positions, path.quaternions, strict=True)
    return "\n".join([head, *(",".join(map(str, (t, *p, q[3], *q[:3]))) for t, p, q in numbers)]).encode()


def hostile(rng: np.random.Generator, sample: Sample, others: list[Sample]) -> bytes:
    """An upload, changed."""
    kind = rng.random()
    if kind < 0.07:
        return raw(rng, sample.whole)
    if kind < 0.1:
        return zipped(list(zip(sample.files, one(rng, others).files.values(), strict=False)))
    if kind < 0.25 and "" not in sample.files:
        return archive(rng, sample.files)
    files = dict(sample.files)
    for _ in range(1 if rng.random() < 0.7 else 3):
        name = one(rng, list(files))
        files[name] = _changed(rng, name, files[name])
    return files[""] if "" in files else zipped(list(files.items()))


def _changed(rng: np.random.Generator, name: str, data: bytes) -> bytes:
    """A file, by its form."""
    try:
        if data.startswith(b"{"):
            return changed_document(rng, data)
        if data.startswith(b"PK"):
            with zipfile.ZipFile(io.BytesIO(data)) as read:
                arrays = {key: read.read(key) for key in read.namelist()}
            if rng.random() < 0.2:
                return archive(rng, arrays)
            key = one(rng, list(arrays))
            return zipped(list((arrays | {key: BY_SUFFIX[".npy"](rng, arrays[key])}).items()))
        return BY_SUFFIX[Path(name).suffix](rng, data)
    except Exception:  # changed before, it is of that form no more
        return raw(rng, data)


class Uploads:
    """Draws cases, and runs them as a server does."""

    def __init__(self, folder: Path, seed: int) -> None:
        lay(folder)
        for name, track in (("pool-dive", "steering"), ("pool-shapes", "segmentation")):
            lay_split(folder / "splits", name, track, hidden=False)
        self.folder, self.seed, self.service = folder, seed, make_service(folder)
        self.samples = samples(self.service.catalogue.splits, folder)
        self.expected = {}
        for kind, sample in self.samples.items():
            (folder / kind).write_bytes(sample.whole)
            self.expected[kind] = self.answer(kind, folder / kind)
            assert all(row["failure"] is None for row in json.loads(self.expected[kind])["results"]), kind

    def draw(self, number: int) -> tuple[str, partial[tuple[str, str]]]:
        """A case by its number."""
        rng = stream(self.seed, b"", "fuzz", "uploads", number)
        kind = list(self.samples)[number % len(self.samples)]
        sample = self.samples[kind]
        (self.folder / "upload").write_bytes(hostile(rng, sample, list(self.samples.values())))
        form = Form("carp", sample.split, sample.track, "https://carp.example", "a carp")
        if rng.random() < 0.1:
            key = one(rng, list(asdict(form)))
            form = replace(form, **{key: str(one(rng, (*VALUES, *WORDS)))})
        return kind, partial(self.run, kind, form, sandboxed=number % SANDBOXED == 0)

    def job(self, kind: str, path: Path, scored: bool) -> Job:
        """What the sandbox is asked for."""
        sample = self.samples[kind]
        served, wanted = self.service.catalogue.find(sample.split, sample.track)
        truth = {name: str(place) for name, place in served.truth.items()} if scored else None
        return Job(str(path), wanted, self.service.settings.limits, (), truth, "carp", CREATED)

    def answer(self, kind: str, path: Path) -> str:
        """What a valid upload scores, as text."""
        checked = do(self.job(kind, path, scored=False))
        assert "refused" not in checked, checked
        return json.dumps(do(self.job(kind, path, scored=True)))

    def run(self, kind: str, form: Form, sandboxed: bool) -> tuple[str, str]:
        """What came of a case. Raises Wrong where a number cannot be, or the next score is another one."""
        found = self.outcome(kind, form, self.folder / "upload", sandboxed)
        if self.answer(kind, self.folder / kind) != self.expected[kind]:
            raise Wrong(f"a valid upload scores otherwise after it; it was {found}")
        return found

    def outcome(self, kind: str, form: Form, path: Path, sandboxed: bool) -> tuple[str, str]:
        """What the server says of an upload."""
        try:
            self.service.check_form(form)
        except Refusal as refusal:
            return "refused", one_line(refusal.reason)
        checked = do(self.job(kind, path, scored=False))
        if sandboxed and (again := self._in_sandbox(kind, path)) != checked:
            raise Wrong(f"the sandbox says {again}, and not {checked}")
        if "refused" in checked:
            return "refused", one_line(checked["refused"]["reason"])
        scored = do(self.job(kind, path, scored=True))
        if "refused" in scored:
            return "refused with the truth", one_line(scored["refused"]["reason"])
        made = Submission(
            "0" * 16,
            "reef lab",
            kind=checked["kind"],
            digest="0" * 64,
            size=1,
            created=CREATED,
            created_s=0.0,
            updated=CREATED,
            **asdict(form),
        )
        record = self.service.build(made, scored)
        for result in record.results if not self.service.catalogue.splits[form.split].any.hidden else ():
            try:  # those of hidden splits are rounded
                check_plausible(result)
            except OysterbenchError as error:
                raise Wrong(str(error)) from None
        if checked["kind"] == "predictions" and self.samples[kind].track == "segmentation":
            self._check_overlap(kind, path, record.results)
        failed = sum(result.failure is not None for result in record.results)
        return ("failed", str(record.results[0].failure)) if failed == len(record.results) else ("scored", "")

    def _in_sandbox(self, kind: str, path: Path) -> dict[str, Any]:
        """The same, from a process of its own with the server's limits, as the server has it read."""
        settings, job = self.service.settings, self.job(kind, path, scored=False)
        try:
            return sandbox.check(settings, path, job.wanted, self.service.hidden, print, self.service.forks)
        except Refusal as refusal:
            return {"refused": {"kind": refusal.kind, "reason": refusal.reason}}

    def _check_overlap(self, kind: str, path: Path, results: tuple[ResultRecord, ...]) -> None:
        """Hold the scored IoU against one by counting, in which every byte but 0 is a pixel of an oyster; of a hidden
        split it is told in steps."""
        told = STEP / 2 if self.service.catalogue.splits[self.samples[kind].split].any.hidden else 0.0
        job = self.job(kind, path, scored=False)
        readers = open_upload(path, job.wanted, job.limits).readers
        for sequence, result in enumerate(results):
            if result.failure is not None:
                continue
            both = either = 0
            for k, name in enumerate(image_names(sequence)):
                true, given = classes(sequence, k)[1] > 0, readers[name]().mask(0.5).view(np.uint8) != 0
                both, either = both + int((true & given).sum()), either + int((true | given).sum())
            if not np.isclose(result.metrics["iou"], both / either, rtol=1e-3, atol=told + 1e-6):
                raise Wrong(f"IoU {result.metrics['iou']} of {both} of {either} pixels")


def one_line(reason: str) -> str:
    """A reason. Raises Wrong where it is no line that a page could show."""
    if not reason or not reason.isprintable() or "Traceback" in reason or tempfile.gettempdir() in reason:
        raise Wrong(f"expected a line, got {reason!r}")
    return reason


def main() -> None:
    """The tool."""
    cv2.setNumThreads(0)
    with tempfile.TemporaryDirectory(prefix="oysterbench-fuzz-") as folder:
        sys.exit(min(tool(__doc__, lambda seed: Uploads(Path(folder), seed).draw), 1))


if __name__ == "__main__":
    main()
