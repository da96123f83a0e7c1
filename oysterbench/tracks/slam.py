"""The SLAM track: sequences in, trajectories out, scored against the ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MethodError, NoTruthError, OysterbenchError, SequenceError, TrajectoryError
from oysterbench.core.measurements import Image
from oysterbench.core.ros import TF_STATIC
from oysterbench.core.text import as_unicode
from oysterbench.core.trajectory import ReadOptions, Trajectory, write_tum
from oysterbench.core.trajectory.frames import with_scale
from oysterbench.evaluate.slam.alignment import meet
from oysterbench.evaluate.slam.inputs import open_pair
from oysterbench.evaluate.slam.scoring import EVALUATOR, SlamResult, SlamSettings, score
from oysterbench.evaluate.slam.settings import SCALED, Align
from oysterbench.evaluate.slam.stretches import errors_by_state, states_at
from oysterbench.methods.adapters import MethodAdapter
from oysterbench.methods.health import HEALTH, NAMES, write_health
from oysterbench.methods.interfaces import RunSequence
from oysterbench.methods.interfaces.slam import SequencePath, read_alternatives, read_estimate, read_run_health
from oysterbench.methods.map import MAP
from oysterbench.methods.outcomes import Job, Outcome
from oysterbench.recipe import SplitRecipe
from oysterbench.report import SlamRun
from oysterbench.results.records import ResultRecord
from oysterbench.sequence import Sequence as SensorSequence
from oysterbench.sequence import open_sequence
from oysterbench.sequence.truth import rig_topics
from oysterbench.simulation.generate import digest
from oysterbench.tracks.slam_options import OPTIONS, read_options
from oysterbench.tracks.slam_truth import true_poses_of, truth_digest
from oysterbench.tracks.track import (
    Evaluation,
    Finished,
    Request,
    Track,
    about_run,
    about_sequence,
    check_names_differ,
    cost_of,
    shown_tables,
)

FRAMES_IN_REPORT = 6
FRAME_WIDTH = 480  # px, in the report
LEFT = (".tum", ".online.tum", ".smoothed.tum", f".{MAP}", f".{HEALTH}")
"""What follows SEQUENCE-METHOD in the names of the files that a run leaves in the folder of the results."""

PATH_METRICS = (
    "ate_rmse_m",
    "ate_percent",
    "ate_rotation_rmse_deg",
    "rpe_1s_translation_rmse_m",
    "coverage",
    "nees_position",
)
"""Metrics kept, where they exist, for the paths of a method that are not scored."""


class SlamSequence(SequencePath):
    """A sequence to run on; split: the split that it belongs to, None for one of the user's own."""

    def __init__(self, name: str, path: Path, split: SplitRecipe | None = None) -> None:
        super().__init__(name, path)
        self.split = split

    @property
    def origin(self) -> str:
        """Split, digest of its recipe, name, and the topics of a reduced file for a sequence of a public split; else
        the file, as the recipe of a hidden split does not determine it."""
        if self.split is not None and not self.split.hidden:
            return " ".join((self.split.name, digest(self.split), self.name, *self.topics))
        return super().origin

    @cached_property
    def topics(self) -> tuple[str, ...]:
        """Topics of a file that has only some of its split's topics; else empty."""
        if self.split is None:
            return ()
        every = set(rig_topics(self.split.rig_of(self.split.find_sequence(self.name))))
        here = {topic for topic, _, _ in open_sequence(self.path).contents()}
        return tuple(sorted(here)) if here < every else ()

    @cached_property
    def truth(self) -> Trajectory | None:
        """Ground truth; None where there is none, or it is withheld. Raises SequenceError or TrajectoryError where it
        cannot be read."""
        try:
            return open_sequence(self.path).truth()
        except NoTruthError:
            return None

    @cached_property
    def frames(self) -> list[tuple[int, bytes]]:
        """Sample frames for the report, see `sample_frames`."""
        return sample_frames(open_sequence(self.path))


class SlamTrack(Track):
    """SLAM track: trajectories of the vehicle from its sensors."""

    name = "slam"
    title = "Trajectories from cameras, inertial sensors and sonars."
    takes = ("slam",)
    splits = ("slam",)
    default_split = "slam-mini"
    # The default split has one camera and an IMU: gtsam_full gains nothing there over gtsam_vi, and visual_only, which
    # has no scale, cannot be scored as these are.
    default_methods = ("gtsam_vi", "dead_reckoning")
    evaluator = EVALUATOR
    files = "trajectories"
    options = OPTIONS
    examples = """
      oysterbench eval slam
      oysterbench eval slam --method dead_reckoning --json
      oysterbench eval slam --runs 5 --out five-runs
      oysterbench eval slam --truth truth.tum --estimate mine.tum --align se3 --associate nearest
      oysterbench eval slam --truth dive.mcap --estimate mine.tum --poses-of cam_left
      oysterbench eval slam --truth truth.tum --estimate mine.tum --report mine.html --tex -"""

    def folder(self, kind: str, options: Mapping[str, Any]) -> str:
        """Name of the output folder: without the track's name, as this track came first."""
        return kind

    def settings(self, options: Mapping[str, Any]) -> SlamSettings:
        """Settings of how estimate and ground truth are matched."""
        return SlamSettings(**{o.key: options[o.key] for o in OPTIONS if not o.files and o.key in options})

    def with_truth(self, topics: Sequence[str]) -> tuple[str, ...]:
        """Add the topics of the ground truth and of the rig's static transforms."""
        return (*topics, "/truth/*", TF_STATIC)

    def run_sequences(
        self, split: SplitRecipe | None, files: Mapping[str, Path], options: Mapping[str, Any]
    ) -> Sequence[SlamSequence]:
        """Sequences of a split, or the user's own: files or folders in EuRoC layout."""
        if split is not None:
            return [SlamSequence(name, path, split) for name, path in files.items()]
        return own_sequences(list(files.values()))

    def score(self, job: Job, outcome: Outcome, out: Path, settings: SlamSettings) -> SlamRun | None:
        """Score the path that a run estimated, and copy it to `out` in TUM format, with its other paths and its map.

        The path is SEQUENCE-METHOD.tum, or SEQUENCE-METHOD-RUN.tum if there are several runs; other paths of the method
        are SEQUENCE-METHOD.NAME.tum, its landmarks SEQUENCE-METHOD.map.ply, and the state in which it estimated each
        pose SEQUENCE-METHOD.health.csv.
        """
        sequence = job.sequence
        assert isinstance(sequence, SlamSequence)
        self._remove_replaced(job, outcome, out)
        estimate, alternatives, health = None, dict[str, Trajectory](), None
        failure = outcome.failure
        if failure is None:
            try:
                estimate = read_estimate(job.folder(out))
                alternatives = read_alternatives(job.folder(out), outcome.prediction)
                health = read_run_health(job.folder(out), outcome.prediction)
                self._keep(job, outcome, out, estimate, alternatives)
                if health is not None:
                    write_health(out / f"{self._name(job)}.{HEALTH}", *health)
            except (MethodError, OSError) as error:
                failure = f"method {job.adapter.name!r} on {sequence.name}: {error}"
        if sequence.truth is None:
            return None
        record, result = record_outcome(sequence, job, outcome, estimate, alternatives, failure, settings)
        if result is not None and estimate is not None:
            carried = with_scale(estimate, result.alignment.scale)
            if carried is not estimate:  # aligning the written file with scale reproduces what was scored
                write_tum(out / f"{self._name(job)}.tum", carried)
        states = None
        if result is not None and health is not None:
            states = states_at(*health, result.stamps_ns)
            found = errors_by_state(result, states, NAMES)
            record = replace(record, info={**record.info, "health": found})
        return SlamRun(record, result, sequence.frames, states)

    @staticmethod
    def _name(job: Job) -> str:
        return f"{job.sequence.name}-{job.adapter.name}{f'-{job.number + 1}' if job.of > 1 else ''}"

    @staticmethod
    def _remove_replaced(job: Job, outcome: Outcome, out: Path) -> None:
        """Delete from `out` what earlier commands left of this run, and of runs of the same method and sequence that
        the results no longer have: whoever reads the folder would take it for theirs."""
        method, named = job.adapter.name, {path.name for path in (out / "runs").glob("*")}
        numbers = [path.name for path in job.folder(out).parent.glob("*") if path.name.isdecimal()]
        gone = [f"{method}-{number}" for number in numbers if job.of == 1 or int(number) > job.of]
        gone = [name for name in gone if name not in named]  # else a method's that is named like a run of this one
        if not outcome.earlier:
            gone += {method, SlamTrack._name(job).removeprefix(f"{job.sequence.name}-")}
        for name in gone:
            for end in LEFT:
                (out / f"{job.sequence.name}-{name}{end}").unlink(missing_ok=True)

    def _keep(
        self, job: Job, outcome: Outcome, out: Path, estimate: Trajectory, alternatives: Mapping[str, Trajectory]
    ) -> None:
        name = self._name(job)
        write_tum(out / f"{name}.tum", estimate)
        for path_name, path in alternatives.items():
            write_tum(out / f"{name}.{path_name}.tum", path)
        if outcome.prediction["map"] is not None:
            write_atomically(out / f"{name}.{MAP}", (job.folder(out) / MAP).read_bytes())

    def run(
        self, sequences: Sequence[RunSequence], adapters: Sequence[MethodAdapter], settings: Any, request: Request
    ) -> Iterator[Finished]:
        """Run as on every track; SEQUENCE-truth.tum is written to `out` only at the end, when no method runs any
        more. Raises TrajectoryError before anything runs where no method can be scored against a ground truth, and
        SequenceError or TrajectoryError where one cannot be read."""
        if request.split is None:
            brought = [{**one.evaluation, **request.options} if one.evaluation else {} for one in adapters]
            judged = [self.settings(own) if own else settings for own in brought]
            for one in sequences:
                check_truth(one, judged)
        truths = {request.out / f"{one.name}-truth.tum": one for one in sequences if isinstance(one, SlamSequence)}
        for path, sequence in truths.items():
            _ = sequence.truth  # read now, and kept: an error would come too late after all runs
            path.unlink(missing_ok=True)
        yield from super().run(sequences, adapters, settings, request)
        for path, sequence in truths.items():
            if sequence.truth is not None:
                write_tum(path, sequence.truth)

    def score_files(self, truth: Path, estimate: Path, options: Mapping[str, Any]) -> Evaluation:
        """Score one trajectory file against another; the options say what the files leave open."""
        run = score_files(truth, estimate, self.settings(options), *read_options(options, truth, estimate))
        return self.show([run], (), None)

    def show(self, runs: Sequence[SlamRun], sequences: Sequence[RunSequence], out: Path | None) -> Evaluation:
        """Show the results by sequence, with standings over several sequences or the spread of runs on one."""
        return Evaluation(runs, printed=shown_tables([run.record for run in runs], runs=True))


def own_sequences(paths: Sequence[Path]) -> list[SlamSequence]:
    """Open the user's own sequences: files, or folders in EuRoC layout. Raises MethodError where two share a name,
    SequenceError or TrajectoryError where a ground truth cannot be read."""
    found = [SlamSequence(open_sequence(path).name, path) for path in paths]
    check_names_differ(found)
    for sequence in found:
        _ = sequence.truth  # read now, and kept: an error would come too late after all runs
    return found


def check_truth(sequence: RunSequence, judged: Sequence[SlamSettings]) -> None:
    """Refuse a ground truth against which not even itself can be scored, whichever of the settings is used: every
    method would seem to fail. Raises TrajectoryError."""
    assert isinstance(sequence, SlamSequence)
    truth, failure = sequence.truth, None
    if truth is None:
        return
    for settings in judged:
        # A scale is fitted to the path of a camera, which may move where the body does not; the first poses of an
        # estimate may be others than those of the truth.
        align: Align = "none" if settings.align in SCALED else settings.align
        try:
            meet(truth, truth, replace(settings, align=align, align_first=None))
            return
        except TrajectoryError as error:
            failure = error
    if failure is not None:
        raise TrajectoryError(f"{sequence.name}: no method can be scored against its ground truth: {failure}")


def record_outcome(
    sequence: SlamSequence,
    job: Job,
    outcome: Outcome,
    estimate: Trajectory | None,
    alternatives: Mapping[str, Trajectory],
    failure: str | None,
    settings: SlamSettings,
) -> tuple[ResultRecord, SlamResult | None]:
    """Make the record of a run on a sequence with ground truth, and its result, None where it failed; estimate,
    alternatives: given where it did not fail."""
    truth = sequence.truth
    assert truth is not None
    about = about_sequence(
        "slam", sequence.split, sequence.name, truth_digest(truth), settings.as_dict(), EVALUATOR
    ) | about_run(job, outcome)
    if sequence.topics:
        about["info"]["topics"] = list(sequence.topics)
    prediction = outcome.prediction
    if failure is None:
        about["info"] |= paths_info(truth, prediction["scored"], alternatives, settings)
        if prediction["map"] is not None:
            about["info"]["map"] = dict(prediction["map"])
    duration = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    cost = cost_of(outcome, "realtime_factor", duration)
    if "realtime_factor" in cost:
        cost["cpu_s_per_s"] = outcome.cpu_s / duration
    if failure is not None or estimate is None:
        return ResultRecord(**about, failure=failure, metrics=cost, notes=tuple(outcome.notes)), None
    try:
        # The notes are from reading the method's own file; the estimate scored here comes from our copy of it.
        result = score(truth, replace(estimate, notes=tuple(outcome.notes)), settings)
    except TrajectoryError as error:
        return ResultRecord(**about, failure=str(error), metrics=cost, notes=tuple(outcome.notes)), None
    metrics = {**result.metrics, **cost}
    return ResultRecord(**about, metrics=metrics, reasons=result.reasons, notes=result.notes), result


def paths_info(
    truth: Trajectory, scored: str, alternatives: Mapping[str, Trajectory], settings: SlamSettings
) -> dict[str, Any]:
    """Entry for the `info` of a record: which of a method's paths is scored, and the PATH_METRICS of each other one.

    An alternative that cannot be scored has a `failure` instead, without affecting the scored path.
    """
    if not scored and not alternatives:
        return {}
    reached: dict[str, dict[str, Any]] = {}
    for name, path in alternatives.items():
        try:
            metrics = score(truth, path, settings).metrics
            reached[name] = {key: metrics[key] for key in PATH_METRICS if key in metrics}
        except TrajectoryError as error:
            reached[name] = {"failure": str(error)}
    return {"paths": {"scored": scored, "alternatives": reached}}


def score_files(
    truth: Path,
    estimate: Path,
    settings: SlamSettings,
    truth_options: ReadOptions | None = None,
    estimate_options: ReadOptions | None = None,
) -> SlamRun:
    """Score one trajectory file against another; the options say what the files leave open."""
    pair = open_pair(true_poses_of(truth, truth_options), estimate, settings, truth_options, estimate_options)
    result = score(*pair, settings)
    given, answered = as_unicode(truth.name), as_unicode(estimate.name)
    about = about_sequence("slam", None, given, truth_digest(pair[0]), settings.as_dict(), EVALUATOR)
    record = ResultRecord(**about, method=answered, metrics=result.metrics, reasons=result.reasons, notes=result.notes)
    return SlamRun(record, result, [])


def sample_frames(sequence: SensorSequence) -> list[tuple[int, bytes]]:
    """A few frames of the first camera, evenly over the sequence: stamp in ns and a small JPEG.

    Frames that cannot be read are left out: they concern the report alone, for which no result is given up.
    """
    camera = next(iter(sequence.cameras), None)
    if camera is None:
        return []
    stamps = []
    with suppress(SequenceError, OSError):
        for image in sequence.images(camera):
            stamps.append(image.stamp_ns)
    if not stamps:  # the camera lost all its frames
        return []
    wanted = {stamps[round(k * (len(stamps) - 1) / (FRAMES_IN_REPORT - 1))] for k in range(FRAMES_IN_REPORT)}
    return [
        (image.stamp_ns, _small_jpeg(image))
        for stamp_ns in sorted(wanted)
        for image in sequence.images(camera, stamp_ns, stamp_ns + 1)
    ]


def _small_jpeg(image: Image) -> bytes:
    height, width = image.pixels.shape[:2]
    small = cv2.resize(image.pixels, (FRAME_WIDTH, round(height * FRAME_WIDTH / width)), interpolation=cv2.INTER_AREA)
    done, jpeg = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])
    if not done:
        raise OysterbenchError(f"{image.camera}: the frame at {image.stamp_ns} could not be encoded")
    return jpeg.tobytes()


TRACK = SlamTrack()
