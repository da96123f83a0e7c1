"""Methods: found by name, run without the truth, failures named."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import Estimate, LandmarkMap, Method, find_method, method_names, run_method
from oysterbench.methods.adapters import ExternalCommand, PythonMethod
from oysterbench.methods.interfaces import Stopwatch
from oysterbench.methods.interfaces.slam import SequencePath, SlamInterface
from oysterbench.methods.options import as_word, with_options
from oysterbench.methods.tuning import OptionRange, trials
from oysterbench_leaderboard.storage.record_summary import SENSORS
from tests.helpers.paths import ROOT


class Still:
    """Stands still at the stamps of the first camera."""

    name = "still"
    track = "slam"

    def run(self, sequence):
        stamps = np.array([image.stamp_ns for image in sequence.images("cam_front")])
        return Estimate(Trajectory(stamps, np.zeros((len(stamps), 3)), np.tile([0.0, 0, 0, 1], (len(stamps), 1))))


class Raises(Still):
    def run(self, sequence):
        raise RuntimeError("out of ideas")


class Peeks(Still):
    def run(self, sequence):
        return Estimate(sequence.truth())


def test_the_baselines_are_installed_as_methods():
    assert {"gtsam_vi", "dead_reckoning"} <= set(method_names("slam"))
    for name in ("gtsam_vi", "dead_reckoning"):
        method = find_method(name)
        assert isinstance(method, Method)
        assert method.name == name


@pytest.mark.parametrize("name", ["dead_reckoning", "gtsam_full", "gtsam_vi", "gtsam_vi_stereo", "visual_only"])
def test_a_baseline_says_what_it_reads_and_when_and_where_its_code_is(name):
    about = find_method(name).about
    assert set(about["sensors"]) <= SENSORS
    assert about["online"] in (True, False)
    assert (ROOT / about["code"] / "method.py").is_file()


def test_an_unknown_method_is_named_with_what_is_installed():
    told = r"unknown method 'orb_slam'; did you mean orb_slam3_mono\? installed methods: .*gtsam_vi"
    with pytest.raises(MethodError, match=told):
        find_method("orb_slam")


def test_a_class_that_a_module_does_not_mention_is_refused_without_importing_what_that_needs(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "slow_net.py").write_text("raise SystemError('imported')\n\nclass MyNet:\n    pass\n")
    with pytest.raises(MethodError, match=r"slow_net\.py has no 'MyNett'; did you mean MyNet\? its classes: MyNet"):
        find_method("slow_net:MyNett")
    with pytest.raises(MethodError, match="SystemError: imported"):
        find_method("slow_net:MyNet")


def test_a_class_that_a_module_has_from_elsewhere_is_found(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "made.py").write_text(
        "from oysterbench_baselines.threshold.method import All\n\ndef __getattr__(name):\n    return All\n"
    )
    assert find_method("made:Anything").name == "all"
    with pytest.raises(
        MethodError, match=r"No module named 'nowhere_at_all'; it was searched for on Python's path and in /"
    ):
        find_method("nowhere_at_all:Net")
    (tmp_path / "plain.py").write_text("class Net:\n    pass\n")
    for file in ("plain.py", "methods/plain.py"):
        with pytest.raises(MethodError, match=r"expected a module, not its file: did you mean plain:Net\?$"):
            find_method(f"{file}:Net")


def test_a_run_is_measured(tiny_file):
    run = run_method(Still(), oysterbench.open(tiny_file))
    assert len(run.estimate.trajectory) == 25
    assert run.wall_s > 0


def test_an_exception_of_a_method_becomes_one_line(tiny_file):
    with pytest.raises(MethodError, match="method 'still' failed on sequence tiny-01: RuntimeError: out of ideas"):
        run_method(Raises(), oysterbench.open(tiny_file))


def test_a_method_that_reaches_for_the_truth_is_stopped(tiny_file):
    with pytest.raises(MethodError, match="methods may not see the ground truth"):
        run_method(Peeks(), oysterbench.open(tiny_file))


@pytest.mark.parametrize(
    ("returned", "got"),
    [
        (None, "None"),
        (Trajectory(np.array([0]), np.zeros((1, 3)), np.array([[0.0, 0, 0, 1]])), "a value of type Trajectory"),
        (Estimate(np.zeros((5, 8))), "an Estimate of a value of type ndarray"),  # type: ignore[arg-type]
        (3, "a value of type int"),
    ],
)
def test_what_is_no_estimate_is_said_to_be_what_it_is(returned, got, tiny_file, tmp_path):
    method = Still()
    method.run = lambda sequence: returned
    with pytest.raises(MethodError) as caught:
        SlamInterface().predict(method, tiny_file, tmp_path, Stopwatch())
    assert str(caught.value).startswith(
        f"method 'still' on {tiny_file.stem}: run() returned {got}, expected an Estimate of a Trajectory: return "
    )


def test_a_method_that_ends_its_process_is_said_to_have_done_so(tmp_path):
    with pytest.raises(MethodError, match=r"^ended before it gave a trajectory \(exit status 0\): it called sys.exit"):
        PythonMethod("dead_reckoning").take(SequencePath("a", tmp_path), tmp_path, tmp_path)


def test_a_name_that_no_record_of_a_board_could_have_is_refused():
    assert ExternalCommand("true {mcap} {out}", "x" * 80).name == "x" * 80
    with pytest.raises(MethodError, match="name of a method: expected at most 80 characters, got 81: 'xx"):
        ExternalCommand("true {mcap} {out}", "x" * 81)


# Variants


@dataclass(frozen=True)
class Inner:
    floor_m: float = 0.5


@dataclass(frozen=True)
class Settings:
    tracks: int = 140
    loops: bool = True
    grid: tuple[int, int] = (5, 4)
    start: Inner = field(default_factory=Inner)


class Optional(Still):
    """Has a parameter of its own and settings."""

    name = "optional"

    def __init__(self, output: str = "smoothed", camera: str | None = None, settings: Settings | None = None):
        self.output, self.camera, self.settings = output, camera, settings or Settings()


HERE = f"{__name__}:Optional"


def test_a_variant_has_its_options_and_a_name_that_says_them():
    method = find_method(f"{HERE}[loops=false, grid=[8,6],start.floor_m=2,output=online,camera=7]")
    assert method.settings == Settings(loops=False, grid=(8, 6), start=Inner(2.0))
    assert (method.output, method.camera) == ("online", 7)
    assert method.name == "optional[loops=false,grid=8-6,start.floor_m=2,output=online,camera=7]"
    assert find_method(HERE).name == "optional"
    assert with_options(f"{HERE}[loops=false]", ["loops=true", "tracks=9"]) == f"{HERE}[loops=true,tracks=9]"


@pytest.mark.parametrize("value", ["a,b", "[a", "b]", "a,[b", '"a,b', '5" x, y', "it's, \\ so"])
def test_values_with_commas_and_brackets_are_given_in_quotes(value):
    reference = f"{HERE}[output={as_word(value)},loops=false]"
    method = find_method(reference)
    assert (method.output, method.settings.loops) == (value, False)
    assert find_method(with_options(reference, ["tracks=9"])).output == value


def test_an_open_bracket_of_one_option_takes_no_other_in():
    method = find_method(with_options(with_options(HERE, ["output=[a"]), ["tracks=9"]))
    assert (method.output, method.settings.tracks) == ("[a", 9)
    with pytest.raises(MethodError, match=r"a bracket or quote does not end; commas separate options, and a value"):
        find_method(f"{HERE}[output=[a,tracks=9]")


def test_a_choice_with_a_comma_is_tried():
    found = trials(HERE, {"output": OptionRange(choices=("a,b", "c"))}, 30)
    assert sorted(find_method(one).output for one in found) == ["a,b", "c", "smoothed"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            "output=a,b",
            "expected key=value, got 'b'; commas separate options, and a value with a comma or bracket is written",
        ),
        (
            "loop=false",
            "has no option 'loop'; its options: output, camera, tracks, loops, grid, start.floor_m",
        ),
        (
            "loops=0",
            "test_methods:Optional': expected true or false, such as true, got '0'",
        ),
        ("tracks=9.5", "expected a whole number, such as 140, got '9.5'"),
        ("start.floor_m=deep", "expected a number, such as 0.5, got 'deep'"),
        ("grid=8", "expected a list, such as [5,4], got '8'"),
        ("loops", "expected key=value, got 'loops'"),
        ("loops=true,loops=false", "'loops' is given twice"),
        ("start=1", "has no option 'start'"),
    ],
)
def test_an_option_that_a_method_does_not_have_is_named_with_those_it_has(options, message):
    with pytest.raises(MethodError) as caught:
        find_method(f"{HERE}[{options}]")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_method_without_options_says_so():
    with pytest.raises(MethodError, match=r"has no option 'loops'; it has none"):
        find_method(f"{__name__}:Still[loops=false]")


# What an estimate may hold


STAMPS = np.arange(3, dtype=np.int64) * 10**9


def path(stamps=STAMPS, **changes):
    n = len(stamps)
    return Trajectory(
        stamps, **{"positions": np.zeros((n, 3)), "quaternions": np.tile([0.0, 0, 0, 1], (n, 1))} | changes
    )


def landmarks(**changes):
    values = {
        "keyframes": path(),
        "landmarks": np.zeros((2, 3)),
        "colours": np.zeros((2, 3), dtype=np.uint8),
        "observations": np.array([1, 2]),
    }
    return LandmarkMap(**values | changes)


@pytest.mark.parametrize(
    ("alternatives", "message"),
    [
        ({"online": path(positions=np.full((3, 3), np.nan))}, "alternative 'online': pose 1: expected finite numbers"),
        ({"online": path(STAMPS[::-1])}, "alternative 'online': pose 2: expected increasing timestamps"),
        ({"online": path(STAMPS[:0])}, "alternative 'online': expected poses, got none"),
        ({"../online": path()}, "name of a path: expected letters, digits and _ -, got '../online'"),
        ({"optimised": path()}, "expected other names than that of the scored path, got 'optimised'"),
    ],
)
def test_a_further_path_that_is_none_is_named(alternatives, message):
    with pytest.raises(MethodError) as caught:
        Estimate(path(), scored="optimised", alternatives=alternatives)
    assert message in str(caught.value)
    assert Estimate(path(), scored="optimised", alternatives={"online": path()}).scored == "optimised"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colours": np.zeros((1, 3), dtype=np.uint8)}, "map: expected colours (2, 3), got (1, 3)"),
        ({"colours": np.zeros((2, 3))}, "map: expected colours as uint8, got float64"),
        ({"observations": np.zeros(2)}, "map: expected observations as whole numbers, got float64"),
        ({"landmarks": np.array([[0.0, 0, 0], [0, np.inf, 0]])}, "map: expected finite landmarks, got"),
        ({"keyframes": path(STAMPS[::-1])}, "map: key frame 2: expected increasing timestamps"),
    ],
)
def test_a_map_of_other_shapes_or_numbers_is_named(changes, message):
    with pytest.raises(MethodError) as caught:
        landmarks(**changes)
    assert message in str(caught.value)
    assert len(landmarks().landmarks) == 2
