"""Published systems of pictures: found, run by name on tracks of images, and known by the files that options name."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest

from oysterbench.annotations import write_folder
from oysterbench.core.errors import MethodError
from oysterbench.methods.options import as_word
from oysterbench.methods.systems import building, find_system, split_reference, track_of
from oysterbench.methods.systems.adapter import SystemAdapter
from oysterbench.methods.systems.manifest import read_system
from oysterbench.report.tuning import best_of
from oysterbench.results.records import ResultRecord, read_results
from tests.helpers.command import run
from tests.helpers.labelled_folders import image
from tests.helpers.toy_system import forget, toy_image_package


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A system of pictures, which is built, with a file of weights under the home; it is found by what is started
    here."""
    folder = toy_image_package(tmp_path / "python")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "python"))
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.syspath_prepend(str(tmp_path / "python"))
    (tmp_path / "home" / "models").mkdir(parents=True)
    (tmp_path / "home" / "models" / "toy.txt").write_text("120")
    forget()
    building.build(find_system("toy"), announce=lambda text: None)
    yield folder
    forget()


@pytest.fixture
def pictures(tmp_path):
    """A labelled folder: light oysters on a dark ground."""
    images = []
    for k in range(2):
        one = image(k)
        one.pixels[:] = np.where(one.oysters, 200, 40)[..., None]
        images.append(one)
    write_folder(images, tmp_path / "pictures")
    return tmp_path / "pictures"


def test_it_runs_by_name_on_the_track_of_its_manifest(toy, pictures, tmp_path):
    done = run("run", "toy_masks", "--on", pictures, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "out" / "results.json")
    assert (record.track, record.metrics["iou"]) == ("segmentation", 1.0)
    assert len(record.method_settings["weights"]) == 64  # what it is, not where
    assert record.info["method"] == {"title": "Toy", "paper": "A. Author: Toy. 2020", "code": "https://toy.example"}
    assert list(record.info["configuration_sha256"]) == ["channel.txt"]
    listed = json.loads(run("systems", "--json").stdout)
    row = next(row for row in listed if row["method"] == "toy_masks")
    assert (row["track"], row["sensors"], row["state"]) == ("segmentation", "images", "built, package")


def test_one_of_detection_leaves_coco_annotations(toy, pictures, tmp_path):
    pytest.importorskip("pycocotools", reason="single oysters are matched by pycocotools")
    done = run("run", "toy_oysters", "--on", pictures, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "out" / "results.json")
    assert (record.track, record.metrics["ap_box"]) == ("detection", pytest.approx(1.0))
    masks = SystemAdapter("toy_masks", ("detection", "segmentation"))  # what hangs together in its masks
    assert (masks.interface.leaves, masks.form) == ("masks or COCO annotations", "images")


def test_trials_are_ranked_by_what_ranks_on_their_track():
    about = {"track": "segmentation", "sequence": "a", "split": "", "settings": {}, "method_settings": {}}
    made = [("toy_masks", {"iou": 0.4}, None), ("toy_masks[channel=1]", {"iou": 0.6}, None), ("none", {}, "failed")]
    records = [
        ResultRecord(**about, method=name, metrics={**metrics, "union_px": 10}, failure=why)
        for name, metrics, why in made
    ]
    assert best_of(records, {name: name for name, _, _ in made}) == ("toy_masks[channel=1]", 0.6)


def test_a_file_of_weights_is_known_by_its_content(toy, tmp_path, monkeypatch):
    """Under another name, or in another folder, it is the same; other content is another method."""
    (tmp_path / "mine.txt").write_text("120")
    (tmp_path / "other").mkdir()
    shutil.copy(tmp_path / "mine.txt", tmp_path / "other" / "copied.txt")
    monkeypatch.chdir(tmp_path)
    one = SystemAdapter("toy_masks[weights=mine.txt]", ("segmentation",))
    same = SystemAdapter(f"toy_masks[weights={tmp_path}/other/copied.txt]", ("segmentation",))
    assert one.name == same.name != "toy_masks"
    assert one.identity == same.identity
    assert one.reference == f"toy_masks[weights={tmp_path}/mine.txt]"  # wherever it is launched
    plain = SystemAdapter("toy_masks", ("segmentation",))
    assert plain.settings == one.settings
    (tmp_path / "mine.txt").write_text("9")
    changed = SystemAdapter("toy_masks[weights=mine.txt]", ("segmentation",))
    assert changed.name != one.name
    assert changed.settings["weights"] != plain.settings["weights"]


@pytest.mark.parametrize("name", ["doe, john", "a]b", 'say "x"', '"x', "a,b=[c"])
def test_a_file_with_any_path_is_given_to_what_launches_it(name, toy, tmp_path, monkeypatch):
    (tmp_path / name).mkdir()
    (tmp_path / name / "a.txt").write_text("120")
    word = as_word(f"{tmp_path}/{name}/a.txt")
    launched = SystemAdapter(f"toy_masks[weights={word}]", ("segmentation",)).reference
    assert split_reference(launched)[2]["weights"] == f"{tmp_path}/{name}/a.txt"
    shutil.copytree(tmp_path / "home", tmp_path / name / "home")
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / name / "home"))
    launched = SystemAdapter("toy_masks", ("segmentation",)).reference
    assert split_reference(launched)[2]["weights"] == f"{tmp_path}/{name}/home/models/toy.txt"


@pytest.mark.slow
def test_other_weights_under_the_home_are_another_run(toy, pictures, tmp_path):
    words = ("run", "toy_masks", "--on", pictures, "--out", tmp_path / "out")
    assert run(*words).returncode == 0
    (tmp_path / "home" / "models" / "toy.txt").write_text("9")
    changed = run(*words)
    assert changed.returncode == 1
    assert "of a different toy_masks (" in changed.stderr
    assert "weights changed" in changed.stderr


@pytest.mark.slow
def test_requirements_of_python_are_installed_beside_what_is_here(toy):
    """What this environment has already, torch among it, is shared and not installed again."""
    manifest = toy / "system.toml"
    manifest.write_text('python = ["numpy"]\n' + manifest.read_text())
    forget()
    system = find_system("toy")
    building.build(system, announce=lambda text: None)
    words = [building.interpreter(system), "-c", "import numpy, oysterbench; print(numpy.__file__)"]
    found = subprocess.run([*map(str, words)], capture_output=True, text=True, check=True, cwd="/").stdout.strip()
    assert found == np.__file__
    assert not list(building.environment(system).glob("lib/python*/site-packages/numpy"))


def test_what_to_type_is_said_where_there_are_no_weights(toy, tmp_path):
    (tmp_path / "home" / "models" / "toy.txt").unlink()
    with pytest.raises(MethodError, match=r"no file .*/home/models/toy\.txt; type: echo 120 > toy\.txt$"):
        split_reference("toy_masks")
    with pytest.raises(MethodError, match=r"option 'weights' of method 'toy_masks': no file never\.txt"):
        split_reference("toy_masks[weights=never.txt]")


def test_a_method_is_of_its_own_track(toy):
    assert (track_of("toy_masks"), track_of("toy_oysters")) == ("segmentation", "detection")
    with pytest.raises(MethodError, match="is of the track 'segmentation'; expected a method of 'slam'"):
        SystemAdapter("toy_masks")


@pytest.mark.parametrize(
    ("text", "instead", "said"),
    [
        ('form = "images"', 'form = "euroc"', "toy_masks.form: expected one of images, as its track is segmentation"),
        ('form = "images"', 'form = "images"\nonline = true', "toy_masks.online: of the track slam; its track is seg"),
        (
            'track = "segmentation"\nform = "images"',
            "online = true",
            "toy_masks.sensors: missing, as its track is slam",
        ),
        ('"segmentation"', '"steering"', "'steering'"),
    ],
)
def test_what_is_not_of_the_track_is_refused(toy, text, instead, said):
    manifest = toy / "system.toml"
    manifest.write_text(manifest.read_text().replace(text, instead, 1))
    with pytest.raises(MethodError, match=said):
        read_system("toy", toy)
