"""The template runs as it is, and so does what the page about the baselines says of adding a method."""

from __future__ import annotations

import re

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.methods import find_method, method_names, run_method
from oysterbench.methods.options import fields_of
from oysterbench_baselines.gtsam_full import GtsamFullSettings
from oysterbench_baselines.gtsam_vi import GtsamViSettings
from tests.helpers.paths import BASELINES

PAGE = (BASELINES / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def dive(dive_file):
    return oysterbench.open(dive_file)


def test_the_template_runs_as_it_is_and_takes_its_option(dive):
    reference = "oysterbench_baselines.template:Template"
    slow = run_method(find_method(reference), dive).estimate
    fast = run_method(find_method(f"{reference}[speed_m_s=0.6]"), dive).estimate
    stamps = [sample.stamp_ns for sample in dive.imu()]
    assert slow.trajectory.stamps_ns.tolist() == stamps
    seconds = (stamps[-1] - stamps[0]) * 1e-9
    assert slow.trajectory.path_length == pytest.approx(0.3 * seconds, rel=1e-9)
    np.testing.assert_allclose(fast.trajectory.positions, 2.0 * slow.trajectory.positions)
    assert fast.info == {"speed_m_s": 0.6}


def test_the_template_is_level_where_gravity_says_so(dive):
    start = run_method(find_method("oysterbench_baselines.template:Template"), dive).estimate.trajectory.matrices[0]
    true_start = dive.truth().matrices[0]
    tilt = np.degrees(np.arccos(np.clip(start[2, :3] @ true_start[2, :3], -1.0, 1.0)))
    assert tilt < 10.0


def test_the_class_on_the_page_runs(dive, tmp_path, monkeypatch):
    (source,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len([line for line in source.splitlines() if line.strip()]) <= 20
    (tmp_path / "slam_of_the_page.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    estimate = run_method(find_method("slam_of_the_page:MySlam"), dive).estimate
    frames = [image.stamp_ns for image in dive.images(next(iter(dive.cameras)))]
    assert estimate.trajectory.stamps_ns.tolist() == frames


def test_the_page_has_every_method_and_every_link_of_it_leads_somewhere():
    for name in method_names("slam"):
        assert f"`{name}`" in PAGE
    for link in re.findall(r"\]\(([^)]+)\)", PAGE):
        assert (BASELINES / link.partition("#")[0]).exists(), link


def test_the_variants_on_the_page_are_there():
    """An option that a method no longer has would make the page wrong."""
    variants = re.findall(r'"(\w+\[[^"]+\])"', PAGE)
    assert variants
    for variant in variants:
        assert find_method(variant).name == variant
    for line in re.findall(r"oysterbench run (gtsam_vi --ablate .*) --split", PAGE):
        method, *words = line.replace("--ablate", "").split()
        for word in words:
            find_method(f"{method}[{word}]")


@pytest.mark.parametrize("method", ["gtsam_vi", "gtsam_vi_stereo", "gtsam_full"])
def test_an_option_that_was_flat_is_answered_by_its_nested_name(method):
    with pytest.raises(MethodError, match=r"no option 'lag_keyframes'; it is called 'window.keyframes' now"):
        find_method(f"{method}[lag_keyframes=6]")


def test_every_new_name_of_an_option_is_there():
    for settings in (GtsamViSettings(), GtsamFullSettings()):
        assert set(settings.renamed.values()) <= set(fields_of(settings))
