"""Random search over options: what is drawn, and the command."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from oysterbench.cli.tune import _check_values
from oysterbench.core.errors import MethodError
from oysterbench.methods.finding import find_method
from oysterbench.methods.options import LONGEST, split_variant, variant_name
from oysterbench.methods.tuning import OptionRange, read_ranges, trials
from oysterbench_leaderboard.storage.record import MOST_TEXT
from tests.helpers.command import run as run_here
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

RANGES = {
    "gain": OptionRange(range=(0.01, 100.0), log=True),
    "count": OptionRange(range=(3, 5)),
    "word": OptionRange(choices=("a", "b")),
    "fixed": OptionRange(default=7),
}


def drawn(count=400):
    return [split_variant(reference)[1] for reference in trials("mine", RANGES, count)[1:]]


def test_values_lie_in_their_ranges_and_fill_them():
    gains = [float(options["gain"]) for options in drawn()]
    assert 0.01 <= min(gains) < 0.02
    assert 50 < max(gains) <= 100
    assert 0.4 < sum(gain < 1 for gain in gains) / len(gains) < 0.6  # on a scale of logarithms
    assert {options["count"] for options in drawn()} == {"3", "4", "5"}
    assert {options["word"] for options in drawn()} == {"a", "b"}
    assert all("fixed" not in options for options in drawn())


@pytest.mark.parametrize("ends", [(0.999, 0.9999), (458.2, 458.9), (1000.4, 1000.6), (-0.9999, -0.999), (1.2345, 1.24)])
def test_values_of_a_narrow_range_lie_in_it_and_fill_it(ends):
    low, high = ends
    for log in (False, low > 0):
        found = [
            float(split_variant(reference)[1]["x"])
            for reference in trials("mine", {"x": OptionRange(range=ends, log=log)}, 60)[1:]
        ]
        assert len(found) > 40
        assert low <= min(found) < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < max(found) <= high
        assert all(len(f"{value!r}") <= 9 for value in found)


def test_a_range_of_one_value_is_that_value():
    assert trials("mine", {"x": OptionRange(range=(0.12345, 0.12345))}, 5) == ["mine", "mine[x=0.12345]"]
    assert trials("mine", {"x": OptionRange(range=(0.0, 0.0))}, 5) == ["mine", "mine[x=0.0]"]


def test_trials_are_a_prefix_of_more_trials_and_depend_on_the_seed_alone():
    assert trials("mine", RANGES, 5) == trials("mine", RANGES, 30)[:5]
    assert trials("mine", RANGES, 5)[0] == "mine"
    assert trials("mine", RANGES, 5, seed=1) != trials("mine", RANGES, 5)
    others = {**RANGES, "more": OptionRange(choices=(True, False))}
    for one, other in zip(drawn(5), trials("mine", others, 5)[1:], strict=True):
        assert split_variant(other)[1].items() >= one.items()  # an option more changes nothing of the others


def test_a_variant_that_is_drawn_again_is_tried_once():
    found = trials("mine", {"loops": OptionRange(choices=(True, False))}, 30)
    assert sorted(found) == ["mine", "mine[loops=false]", "mine[loops=true]"]


def test_nothing_to_try_is_refused():
    with pytest.raises(MethodError, match="no option has a range or choices"):
        trials("mine", {"fixed": OptionRange(default=7)}, 5)


def test_a_wrong_file_of_ranges_is_named(tmp_path):
    (tmp_path / "ranges.toml").write_text("[gain]\nrange = [1.0]\n")
    with pytest.raises(MethodError, match=r"ranges\.toml: .*gain"):
        read_ranges(tmp_path / "ranges.toml")


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ("range = [0.0, 1.0]\nlog = true", r"range: expected numbers above 0 with log = true, got \[0\.0, 1\.0\]"),
        ("range = [-2, 5]\nlog = true", r"range: expected numbers above 0 with log = true, got \[-2, 5\]"),
        ("range = [nan, 1.0]", r"range: expected finite numbers, got \[nan, 1\.0\]"),
        ("range = [1, inf]", r"range: expected finite numbers, got \[1, inf\]"),
        ("range = [1.0, 0.1]", r"range: expected the lowest value first, got \[1\.0, 0\.1\]"),
        ("range = [1, 2]\nchoices = [1]", "expected either range or choices, got both"),
        ("choices = [1, 2]\nlog = true", "log: expected a range with it, got none"),
        ("choices = []", "choices: expected at least one value, got none"),
        ("rang = [1, 2]", "expected default, range, log, choices, got 'rang'"),
    ],
)
def test_nonsense_in_a_file_of_ranges_is_refused_with_file_option_and_what_was_expected(table, why, tmp_path):
    (tmp_path / "ranges.toml").write_text(f"[good]\nrange = [1, 1]\n[bad]\n{table}\n")
    with pytest.raises(MethodError, match=rf"^{tmp_path}/ranges\.toml: \[bad\] {why}$"):
        read_ranges(tmp_path / "ranges.toml")


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ("[window]\nrange = [1, 2.5]", r"\[window\] .*'window'.*: expected a whole number, such as 30, got '2\.5'"),
        ("[loops]\nchoices = [true, 2]", r"\[loops\] .*'loops'.*: expected true or false, such as true, got '2'"),
        ("[speed]\nrange = [1, 2]", r"\[speed\] .*'speed'"),
    ],
)
def test_values_that_a_method_does_not_take_are_refused_before_the_first_run(table, why, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "tuned_method.py").write_text(
        "class Tuned:\n    name, track = 'tuned', 'slam'\n\n"
        "    def __init__(self, window: int = 30, loops: bool = True): ...\n    def run(self, sequence): ...\n"
    )
    (tmp_path / "ranges.toml").write_text(table)
    words = ("tune", "tuned_method:Tuned", "--split", "slam-mini", "--ranges", tmp_path / "ranges.toml")
    done = run_here(*words, "--out", tmp_path / "out")
    assert done.returncode == 1
    assert re.fullmatch(rf"oysterbench: {tmp_path}/ranges\.toml: {why}.*\n", done.stderr), done.stderr
    assert not (tmp_path / "out").exists()


def test_a_method_without_ranges_of_its_own_is_refused_with_what_gives_some(tmp_path):
    done = run_here("tune", "gtsam_vi", "--out", tmp_path / "out")
    assert done.returncode == 2
    told = " ".join(done.stderr.split())
    assert "give --ranges FILE.toml, with a table [OPTION] for each: range = [1, 9], or choices = [...]" in told


def test_values_that_only_go_together_are_taken(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "tuned_ends.py").write_text(
        "class Ends:\n    name, track = 'ends', 'slam'\n\n"
        "    def __init__(self, low: float = 1.0, high: float = 5.0):\n"
        "        if low >= high:\n            raise ValueError('low is not below high')\n\n"
        "    def run(self, sequence): ...\n"
    )
    ranges = {"low": OptionRange(range=(0.5, 9.0)), "high": OptionRange(range=(10.0, 20.0))}
    found = trials("tuned_ends:Ends", ranges, 4)
    _check_values(Path("ranges.toml"), ranges, found[:2], find_method)
    for one in found:
        find_method(one)
    with pytest.raises(MethodError, match=r"^ranges\.toml: \[low\] .*low is not below high"):
        _check_values(Path("ranges.toml"), {"low": OptionRange(range=(0.5, 50.0))}, found[:2], find_method)


def test_the_name_of_many_options_fits_a_folder():
    options = {f"option_{i}": str(i) for i in range(60)}
    name = variant_name("mine", options)
    assert len(name) < LONGEST
    few = variant_name("orb_slam3_mono_inertial", {f"option_{i}": "0.125" for i in range(6)})
    assert len(few) <= LONGEST <= MOST_TEXT["method"]
    assert name != variant_name("mine", {**options, "option_0": "1"})
    long = "x" * (LONGEST - 10)
    for some in ({"gain": "0.1"}, options):
        assert len(variant_name(long, some)) == LONGEST
        assert variant_name(long, some) != variant_name(long, dict.fromkeys(some, "2"))
    (first, *_) = trials("oysterbench_baselines.template:Template", {"speed_m_s": OptionRange(range=(0.1, 0.5))}, 2)[1:]
    assert find_method(first).speed_m_s == float(split_variant(first)[1]["speed_m_s"])


def test_other_options_give_another_name():
    values = ["-2", "2", "[-1, 2]", "[1, 2]", "[1, -2]", "cfg/a.yaml", "cfg-a.yaml", "[x", "x]", "a b", "a-b", "ä", "ö"]
    names = [variant_name("mine", {"drift": value}) for value in values]
    assert len(set(names)) == len(values)
    assert names[:4] == ["mine[drift=-2]", "mine[drift=2]", "mine[drift=-1-2]", "mine[drift=1-2]"]
    many = [variant_name("mine", {f"option_{i}": value for i in range(60)}) for value in values]
    assert len(set(many)) == len(values)
    # A name that is on the board does not change.
    record = variant_name("mine", {f"option_{i}": str(i) for i in range(60)})
    assert record == "mine[60-options-2b3f4b45]"


def test_a_draw_of_the_defaults_is_the_method_itself():
    loops, gain = OptionRange(choices=(True, False), default=True), OptionRange(choices=(1, 2), default=1.0)
    assert trials("mine", {"loops": loops}, 30) == ["mine", "mine[loops=false]"]
    assert sorted(trials("mine", {"loops": loops, "gain": gain}, 30)) == [
        "mine",
        "mine[loops=false,gain=1]",
        "mine[loops=false,gain=2]",
        "mine[loops=true,gain=2]",
    ]


def test_a_value_written_in_two_ways_is_tried_once():
    assert len(trials("mine", {"gain": OptionRange(choices=(1, 1.0))}, 30)) == 2


def test_a_trial_that_the_machine_killed_is_told_and_is_not_the_best(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    (tmp_path / "tuned_killed.py").write_text(
        "import os\nfrom oysterbench_baselines.template import Template\n\n\n"
        "class Killed(Template):\n    name = 'killed'\n\n"
        "    def __init__(self, dies: bool = False):\n        super().__init__()\n        self.dies = dies\n\n"
        "    def run(self, sequence):\n        if self.dies:\n            os.kill(os.getpid(), 9)\n"
        "        return super().run(sequence)\n"
    )
    (tmp_path / "ranges.toml").write_text("[dies]\nchoices = [false, true]\n")
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    (tmp_path / "tiny.toml").write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "rig.toml"'))
    words = ["tune", "tuned_killed:Killed", "--split", tmp_path / "tiny.toml", "--sequence", "tiny-01"]
    words += ["--topics", "/imu", "--ranges", tmp_path / "ranges.toml", "--out", tmp_path / "out"]
    done = run_here(*words, home=tmp_path / "home")
    assert done.returncode == 1
    assert "killed by SIGKILL" in done.stderr
    assert done.stderr.rstrip().endswith("; the run is not counted, and the same command runs it again")
    assert done.stdout.splitlines()[-1] == "tuned_killed:Killed"
