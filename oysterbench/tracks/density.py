"""The density track: maps of oysters along the paths of SLAM methods, from the masks of image methods."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oysterbench.annotations import labelled_sequence
from oysterbench.annotations.forms import FORMS
from oysterbench.core.errors import MachineError, MethodError, TrajectoryError
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.evaluate.density.scoring import EVALUATOR
from oysterbench.evaluate.detection.instances import mask_tools
from oysterbench.methods.adapters import PythonMethod, check_distinct
from oysterbench.methods.checks import check_shape
from oysterbench.methods.images import Detections
from oysterbench.methods.interfaces import RunSequence
from oysterbench.methods.interfaces.images import read_predictions
from oysterbench.methods.outcomes import Job, Outcome
from oysterbench.recipe import SplitRecipe
from oysterbench.sequence import open_sequence
from oysterbench.tracks.images import PictureSequence, instances_of, segmentation_of
from oysterbench.tracks.slam import TRACK as SLAM
from oysterbench.tracks.slam import SlamSequence
from oysterbench.tracks.slam_options import SETTINGS
from oysterbench.tracks.track import Evaluation, Option, Request, Track, shown_tables

# The mapping modules are imported where they are used: every command loads this track, but few make a map.
if TYPE_CHECKING:
    from oysterbench.mapping import MapSettings, Seen
    from oysterbench.report.density import DensityRun

IMAGES = ("segmentation", "detection")
DEPTHS = ("stereo", "motion", "plane", "layer")
TRUTH = "truth"


class DensityTrack(Track):
    """Density track: oysters per square metre."""

    name = "density"
    title = "Oysters per square metre, from paths and masks."
    takes = ("slam", *IMAGES)
    splits = ("slam", "segmentation")
    default_split = "slam-mini"
    default_methods = ("dead_reckoning",)
    evaluator = EVALUATOR
    options = (
        Option(
            "poses",
            "--poses",
            "Folder of SEQUENCE-METHOD.tum files, as written by `run`: all are used, or only those of each --method.",
            Path,
        ),
        Option(
            "masks",
            "--masks",
            "Oyster masks for the images; of several sequences, a folder of each.  [default: truth]",
            Path,
        ),
        Option("kind", "--masks-kind", "Meaning of the masks' values.  [default: auto]", FORMS),
        Option("depth", "--depth", "Source of depths.  [default: layer]", DEPTHS),
        Option("cell_m", "--cell", "Size of the grid cells, in m.  [default: 1]", float),
        *(option for option in SETTINGS if option.key in ("align", "max_gap_s")),
    )
    examples = """
      oysterbench eval density --split slam-val --method gtsam_full --method dead_reckoning
      oysterbench eval density --split slam-val --poses results --masks masks --depth stereo
      oysterbench eval density --split slam-val --poses results --method mine   only results/*-mine.tum"""

    def settings(self, options: Mapping[str, Any]) -> MapSettings:
        """Settings of the maps."""
        from oysterbench.mapping import MapSettings

        return MapSettings(**{key: options[key] for key in ("cell_m", "max_gap_s") if key in options})

    def with_truth(self, topics: Sequence[str]) -> tuple[str, ...]:
        """Add the topics of the ground truth; the layers of the camera that is mapped must be among those given."""
        return SLAM.with_truth(topics)

    def check(self, request: Request) -> None:
        """Also refuse topics that lack the layers of which the true map is made."""
        from oysterbench.simulation.jobs import wanted_topics
        from oysterbench.tracks.mapping_evaluation import camera_with_layers

        super().check(request)
        split = request.split
        for sequence in () if split is None or not request.topics else split.sequence:
            if not request.sequences or sequence.name in request.sequences:
                assert split is not None
                cameras = [camera.name for camera in split.rig_of(sequence).camera]
                camera_with_layers(sequence.name, cameras, wanted_topics(split, sequence, request.topics))

    def run_sequences(
        self, split: SplitRecipe | None, files: Mapping[str, Path], options: Mapping[str, Any]
    ) -> Sequence[SlamSequence]:
        """Sequences as on the SLAM track."""
        return SLAM.run_sequences(split, files, options)

    def score(self, job: Job, outcome: Outcome, out: Path, settings: MapSettings) -> None:
        """Return None: a path or masks alone make no map to score."""

    def evaluate(self, request: Request) -> Evaluation:
        """Build maps and score them. SLAM methods provide paths, image methods provide masks."""
        from oysterbench.mapping import check_seen, read_seen
        from oysterbench.report.density_figure import drawn
        from oysterbench.tracks.mapping_evaluation import MappedSequence, evaluate_maps

        self.check(request)
        if (
            request.options.get("masks") == Path(TRUTH) and not Path(TRUTH).exists()
        ):  # the default, by name as for `map`
            request = replace(request, options={k: v for k, v in request.options.items() if k != "masks"})
        SLAM.settings(request.options)  # refused before methods are run, and though none is
        options, settings = request.options, self.settings(request.options)
        if request.template is not None or request.runs > 1:
            raise MethodError("density: maps need Python methods, each run once, or --poses and --masks")
        methods, kept = self._named(request)
        images = [method for method in methods if method.track in IMAGES]
        if any(method.track == "detection" for method in images):
            mask_tools()  # by which their oysters are read, after all runs
        if "masks" in options and images:
            raise MethodError(f"--masks and {images[0].name}: expected masks from one of them")
        self.have_weights(methods, request)
        once = replace(request, runs=1)
        runs: list[DensityRun] = []
        sequences = self.run_sequences(request.split, self.rendered(request), options)
        names = {one.name for one in (sequences if request.split is None else request.split.sequence)}
        if request.split is None and "poses" in options:  # which may have estimates of the user's other sequences too
            names |= _with_truth(options["poses"])
        own: dict[str, dict[str, Callable[[], Iterator[Seen]]]] = {}
        for sequence in sequences if "masks" in options else ():
            opened, camera = _with_camera(sequence)
            kind, several = options.get("kind", "auto"), len(sequences) > 1
            seen = partial(read_seen, options["masks"], opened, camera, kind, settings.threshold, several)
            check_seen(seen(), opened, camera)  # before methods are run, some for hours
            own[sequence.name] = {options["masks"].name: seen}
        for sequence in sequences:
            opened, camera = _with_camera(sequence)
            paths = self._paths(sequence, [one for one in methods if one.track == "slam"], kept, once, names)
            masks = own.get(sequence.name) or self._masks(sequence, camera, images, once, settings)
            mapped = MappedSequence(opened, camera, paths, masks, sequence.topics, bool(own))
            depth, align = options.get("depth", "layer"), options.get("align", "posyaw")
            for run in evaluate_maps(mapped, sequence.split, settings, depth, align, request.announce):
                runs.append(drawn(run))
                request.finished(runs)
        return self.show(runs, sequences, request.out)

    def show(self, runs: Sequence[DensityRun], sequences: Sequence[RunSequence], out: Path | None) -> Evaluation:
        """Show the results by sequence, with the maps."""
        return Evaluation(runs, printed=shown_tables([run.record for run in runs]))

    def _named(self, request: Request) -> tuple[list[PythonMethod], list[str] | None]:
        """Methods to run, and the methods whose estimates are taken from --poses; None for all that it has.

        A method with estimates there is not run. Raises MethodError for one that has none and is not known either.
        """
        folder = request.options.get("poses")
        names = dict.fromkeys(request.methods or (() if folder is not None else self.default_methods))
        if folder is None:
            return check_distinct({name: PythonMethod(name, self.takes) for name in names}), []
        methods, kept = list[PythonMethod](), list[str]()
        for name in names:
            if _has_estimates(folder, name):
                kept.append(name)
                continue
            try:
                method = PythonMethod(name, self.takes)
            except MethodError as error:
                raise MethodError(f"{folder} has no estimates SEQUENCE-{name}.tum, and: {error}") from None
            if _has_estimates(folder, method.name):  # given as module:Class
                kept.append(method.name)
            else:
                methods.append(method)
        check_distinct({method.reference: method for method in methods})
        of_slam = [method for method in methods if method.track == "slam"]
        for method in of_slam:
            request.announce(f"{folder} has no estimates of {method.name}, which is therefore run")
        return methods, kept if kept or of_slam else None

    def _paths(
        self,
        sequence: SlamSequence,
        methods: Sequence[PythonMethod],
        kept: list[str] | None,
        request: Request,
        names: Collection[str],
    ) -> dict[str, Trajectory | Exception]:
        """Paths by method: those `kept` in a folder (None for all), and from running the methods; an exception with the
        reason where there is none. names: of all sequences."""
        found: dict[str, Trajectory | Exception] = {}
        if (folder := request.options.get("poses")) is not None and kept != []:
            there = estimates_in(folder, sequence.name, names)
            if not there and kept is None:
                raise TrajectoryError(f"{folder}: expected estimates of {sequence.name}, {sequence.name}-METHOD.tum")
            for name in there if kept is None else kept:
                missing = TrajectoryError(f"{folder} has no {sequence.name}-{name}.tum")
                found[name] = _read(there[name]) if name in there else missing
        within = replace(request, out=request.out / "paths")
        for done in SLAM.run([sequence], methods, SLAM.settings(request.options), within) if methods else ():
            failed = _failure(done.outcome)
            name = done.job.adapter.name
            file = within.out / f"{sequence.name}-{name}.tum"
            found[name] = _read(file) if failed is None else MethodError(failed)
        return found

    def _masks(
        self,
        sequence: SlamSequence,
        camera: str,
        methods: Sequence[PythonMethod],
        request: Request,
        settings: MapSettings,
    ) -> dict[str, Callable[[], Iterator[Seen]]]:
        """Function by method that iterates over the oysters seen in each image; empty if the ground-truth masks are
        used."""
        within = replace(request, out=request.out / "masks")
        pictures = PictureSequence(labelled_sequence(sequence.path), [sequence.path], sequence.split)
        done = self.run([pictures], methods, settings, within) if methods else ()
        return {
            each.job.adapter.name: partial(_seen, each.job, each.outcome, within.out, camera, settings.threshold)
            for each in done
        }


def _with_camera(sequence: SlamSequence) -> tuple[Any, str]:
    """Sequence, opened, and the camera along whose images it is mapped."""
    from oysterbench.tracks.mapping_evaluation import camera_with_layers

    opened = open_sequence(sequence.path)
    topics = {topic for topic, _, _ in opened.contents()}
    return opened, camera_with_layers(opened.name, opened.cameras, topics)


def _read(path: Path) -> Trajectory | TrajectoryError:
    """Path from a file, or why it cannot be read: a failure of this path alone."""
    try:
        return read_trajectory(path)
    except TrajectoryError as error:
        return error


def _failure(outcome: Outcome) -> str | None:
    """Reason why the method failed, or None. Raises MachineError where the machine failed instead."""
    if not outcome.finished:
        raise MachineError(outcome.failure)
    return outcome.failure


def _seen(job: Job, outcome: Outcome, out: Path, camera: str, threshold: float) -> Iterator[Seen]:
    """Iterate over the oysters that a method found in the images of a camera. Raises MethodError where it failed."""
    from oysterbench.mapping.predicted import components, stacked

    if (failed := _failure(outcome)) is not None:
        raise MethodError(failed)
    assert isinstance(job.sequence, PictureSequence)
    labelled = job.sequence.labelled
    found = read_predictions(job.folder(out), labelled.names)
    for prediction, (truth, _) in zip(found, labelled.images(), strict=True):
        _, of, stamp = truth.name.rsplit("/", 2)
        if of == camera:
            shape = (truth.classes.shape[0], truth.classes.shape[1])
            if isinstance(prediction, Detections):
                yield stacked(int(stamp), camera, instances_of(prediction, job.adapter.name, shape, threshold))
            else:  # as masks in files
                mask = segmentation_of(prediction, job.adapter.name)
                check_shape(mask.shape, shape, f"method {job.adapter.name!r} on {prediction.name}")
                yield components(int(stamp), camera, mask.mask(threshold), mask.probability)


def _has_estimates(folder: Path, method: str) -> bool:
    """Whether a folder has an estimate of a method, as `estimates_in` finds them, of any sequence."""
    return _is_main(method) and any(file.name.endswith(f"-{method}.tum") for file in folder.glob("*.tum"))


def _is_main(method: str) -> bool:
    """Whether METHOD in SEQUENCE-METHOD.tum names a method's main path. Options in brackets may have decimal points."""
    return "." not in method.rpartition("]")[2] and method != "truth"


def _with_truth(folder: Path) -> set[str]:
    """Names of the sequences whose ground truth is in a folder."""
    return {path.stem.removesuffix("-truth") for path in folder.glob("*-truth.tum")}


def estimates_in(folder: Path, sequence: str, names: Collection[str] | None = None) -> dict[str, Path]:
    """Files SEQUENCE-METHOD.tum in a folder by method, as `oysterbench run` writes them; further paths of a method
    (SEQUENCE-METHOD.NAME.tum), the ground truth, and what is of sequences whose names begin alike are left out.

    names: of all sequences; None: those with a ground truth there.
    """
    known = _with_truth(folder) if names is None else names
    others = tuple(f"{name}-" for name in known if name.startswith(f"{sequence}-"))
    found = {}
    for path in sorted(folder.glob(f"{sequence}-*.tum")):
        method = path.stem.removeprefix(f"{sequence}-")
        if _is_main(method) and not path.stem.startswith(others):
            found[method] = path
    return found


TRACK = DensityTrack()
