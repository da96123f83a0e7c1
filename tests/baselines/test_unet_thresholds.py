"""What the thresholds of trained weights were measured on, and what there is where nothing could be measured."""

from __future__ import annotations

import dataclasses
import datetime

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from click.testing import CliRunner  # noqa: E402

from oysterbench.annotations import Entry, LabelledImage, LabelledSet, open_labelled, write_folder  # noqa: E402
from oysterbench.cli.main import main  # noqa: E402
from oysterbench.core.errors import LabelError, MethodError  # noqa: E402
from oysterbench.methods.weights import weights_path  # noqa: E402
from oysterbench_baselines.learning.checkpoint import read_checkpoint  # noqa: E402
from oysterbench_baselines.unet.calibration import LEAST, Calibration, kept_back, measured  # noqa: E402
from oysterbench_baselines.unet.training import thresholds_of, train  # noqa: E402
from oysterbench_baselines.unet.views import Look  # noqa: E402
from tests.helpers.labelled_folders import yolo_folder  # noqa: E402
from tests.helpers.small_trainings import SMALL, small_set  # noqa: E402

ONE = dataclasses.replace(SMALL, fit=dataclasses.replace(SMALL.fit, steps=1))
CPU = torch.device("cpu")
KNOWN = Calibration(temperature=1.5, cut=0.4, rise=0.06, sure=0.3, live_cut=1.0, states=0.9, images=240)


@pytest.fixture
def begun(tmp_path):
    """Weights whose thresholds were measured on many images."""
    checkpoint = train(small_set(tmp_path / "many", {"one": ("", 2)}), tmp_path / "begun.pt", ONE, 0, CPU)
    checkpoint.measured["calibration"] = dataclasses.asdict(KNOWN)
    checkpoint.write(tmp_path / "begun.pt")
    return tmp_path / "begun.pt"


def test_a_training_on_few_images_keeps_the_thresholds_of_the_weights_that_it_began_with(tmp_path, begun):
    small_set(tmp_path / "few", {"one": ("", 9)})
    words = ["train", "unet_small", "--data", str(tmp_path / "few"), "--begin", str(begun), "--steps", "1"]
    done = CliRunner().invoke(main, [*words, "--out", str(tmp_path / "mine.pt"), "--device", "cpu", "--threads", "1"])
    assert done.exit_code == 0, done.stderr
    mine = read_checkpoint(tmp_path / "mine.pt")
    assert Calibration(**mine.measured["calibration"]) == KNOWN
    said = (
        "fewer than 5 images held out show an oyster: the thresholds of the initial weights are kept, measured "
        "on 240 images"
    )
    assert said in " ".join(done.stderr.split())


def test_a_training_begins_with_the_weights_of_a_name(tmp_path, begun, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_UNET_SMALL", str(begun))
    small_set(tmp_path / "few", {"one": ("", 2)})
    words = ["train", "unet_small", "--data", str(tmp_path / "few"), "--steps", "1", "--device", "cpu", "--begin"]
    out = ["--out", str(tmp_path / "mine.pt")]
    done = CliRunner().invoke(main, [*words, "unet_small", *out])
    assert done.exit_code == 0, done.stderr
    first = read_checkpoint(begun).identity
    assert read_checkpoint(tmp_path / "mine.pt").identity["begun"] == {**first, "steps": ONE.fit.steps}
    for name, meant in (("elsewhere", ""), ("unet_smal", "did you mean unet_small or unet? ")):
        failed = CliRunner().invoke(main, [*words, name, *out])
        assert failed.exit_code != 0
        assert f"{name}: no such checkpoint; {meant}`oysterbench train` makes one" in failed.stderr
    for name in ("unet", "moving"):
        failed = CliRunner().invoke(main, [*words, name, *out])
        assert failed.exit_code == 1
        assert f"--begin {name}: these are weights of another network; begin with a file of" in failed.stderr


@pytest.mark.parametrize("begin", ["begun.pt", "unet_small"])
def test_no_training_writes_over_the_weights_that_it_begins_with(tmp_path, home, begun, begin, monkeypatch):
    """Nor where a name means those of oysterbench, and would mean the new ones once the training was interrupted."""
    monkeypatch.delenv("OYSTERBENCH_UNET_SMALL", raising=False)
    monkeypatch.chdir(tmp_path)
    words = ["train", "unet_small", "--data", str(tmp_path / "many"), "--steps", "2", "--begin", begin]
    if begin == "unet_small":
        out = weights_path(begin)
    else:
        out = begun
        words += ["--out", str(out)]
    kept = begun.read_bytes()
    for more in ([], ["--again"]):
        done = CliRunner().invoke(main, [*words, *more])
        assert done.exit_code == 1
        assert f"{out}: expected another file than that of --begin {begin}: " in " ".join(done.stderr.split())
        assert "choose another --out" in " ".join(done.stderr.split())
    assert begun.read_bytes() == kept
    monkeypatch.setenv("OYSTERBENCH_UNET_SMALL", str(begun))
    done = CliRunner().invoke(main, ["train", "unet_small", *words[2:6], "--begin", "unet_small"])
    assert f"{begun}: expected another file than that of --begin unet_small" in " ".join(done.stderr.split())


def test_where_enough_images_are_held_out_thresholds_are_measured_anew_and_on_how_many_is_said(tmp_path, begun):
    checkpoint = train(
        small_set(tmp_path / "more", {"one": ("", 50)}), tmp_path / "a.pt", ONE, 0, CPU, begun=read_checkpoint(begun)
    )
    assert checkpoint.measured["calibration"]["images"] == 5
    assert thresholds_of(checkpoint, read_checkpoint(begun)) == "thresholds were measured on 5 images held out"


def test_a_few_images_with_oysters_replace_no_thresholds_but_the_default_ones(tmp_path):
    labelled = small_set(tmp_path, {"one": ("", LEAST)})

    def found(count, otherwise):
        few = LabelledSet("few", [*labelled.entries[:count], *map(without_oysters, labelled.entries[count:])])
        return measured(few, lambda pixels: Look(np.zeros((2, *pixels.shape[:2]), np.float32)), otherwise=otherwise)

    assert found(LEAST - 1, KNOWN) == KNOWN
    assert found(LEAST, KNOWN).images == found(1, None).images == LEAST


def without_oysters(entry):
    def read():
        image = entry.read()
        return dataclasses.replace(image, classes=0 * image.classes, instances=0 * image.instances)

    return dataclasses.replace(entry, read=read)


def test_weights_that_were_measured_before_the_number_of_images_was_kept_have_no_default_thresholds(tmp_path):
    checkpoint = train(small_set(tmp_path, {"one": ("", 4)}), tmp_path / "a.pt", ONE, 0, CPU)
    checkpoint.measured["calibration"] = {"temperature": 1.4, "cut": 0.3, "rise": 0.06, "sure": 0.31}
    assert thresholds_of(checkpoint) == "thresholds were measured on images held out"


@pytest.mark.parametrize("finished", [False, True])
def test_a_training_that_held_out_other_images_is_not_resumed_though_finished_weights_of_before_stay(
    tmp_path, finished
):
    labelled = small_set(tmp_path / "set", {"one": ("", 10)})
    before = train(labelled, tmp_path / "a.pt", ONE, 0, CPU)
    del before.identity["held_out"]  # as before it was kept
    dataclasses.replace(before, measured=before.measured if finished else {}).write(tmp_path / "a.pt")
    if finished:
        assert train(labelled, tmp_path / "a.pt", ONE, 0, CPU).digest() == before.digest()
    else:
        with pytest.raises(MethodError, match=r"held out other images .*, or does not say which; remove it"):
            train(labelled, tmp_path / "a.pt", ONE, 0, CPU)


def test_weights_with_default_thresholds_say_so(tmp_path):
    checkpoint = train(small_set(tmp_path / "few", {"one": ("", 4)}), tmp_path / "a.pt", ONE, 0, CPU)
    assert thresholds_of(checkpoint) == (
        "no oyster in images held out: thresholds are the default ones, and counts may be far off"
    )
    nothing = small_set(tmp_path / "more", {"one": ("", 2)}).where(lambda entry: False)
    assert measured(nothing, lambda pixels: Look(np.zeros((2, 4, 4), np.float32)), otherwise=KNOWN) == KNOWN


def test_a_bad_label_of_an_image_held_out_is_found_before_the_training(tmp_path):
    """And not when it is measured on: with the label mended, the set is another, and the training would be lost."""
    folder = yolo_folder(tmp_path / "set", {f"f{k:02}": "" for k in range(20)})
    (folder / "labels" / "f19.txt").write_text("0 0.5 0.5 0.2 0.2\n")
    labelled = open_labelled(folder)
    assert "f19" in {entry.name for entry in kept_back(labelled)[1].entries}
    with pytest.raises(LabelError, match=r"f19\.txt:1: .*a box, not a polygon"):
        train(labelled, tmp_path / "a.pt", ONE, 0, CPU, lambda done, total: pytest.fail("it was trained"))
    (folder / "labels" / "f19.txt").write_text("")
    read = []
    train(open_labelled(folder), tmp_path / "a.pt", ONE, 0, CPU, loading=lambda *done: read.append(done))
    assert read == [(k, 20) for k in range(1, 21)]


def test_of_a_folder_that_was_written_from_two_cameras_the_same_instants_are_kept_back_too(tmp_path):
    pixels = np.zeros((8, 8), np.uint8)
    names = [f"reef/{camera}/{k:04}" for camera in ("cam_down", "cam_close") for k in range(10)]
    layers = (np.stack([pixels] * 3, -1), pixels, pixels.astype(np.uint16), pixels > 0)
    write_folder([LabelledImage(name, "reef", *layers) for name in names], tmp_path)
    kept = kept_back(open_labelled(tmp_path))[1]
    assert [entry.name for entry in kept.entries] == ["reef-cam_down-0009", "reef-cam_close-0009"]


def test_where_no_clips_are_known_the_last_by_name_are_kept_back_of_each_folder():
    """And not every tenth frame of a video, between two that were learnt from."""
    names = [f"{place}/f{k:03}" for place in ("mine", "more") for k in reversed(range(20))]
    entries = [Entry(name, name, lambda: pytest.fail("it was read"), ()) for name in names]
    kept = kept_back(LabelledSet("set", entries))[1]
    assert [entry.name for entry in kept.entries] == ["mine/f019", "mine/f018", "more/f019", "more/f018"]
    entries = [*entries[:9], *(Entry(f"reef/{k}", "reef", lambda: pytest.fail("it was read"), ()) for k in range(10))]
    assert [entry.name for entry in kept_back(LabelledSet("set", entries))[1].entries] == ["reef/9"]


QUADRATS = [f"q{k:02}-{n:02}" for k in range(1, 31) for n in range(1, 11 if k == 1 else 10)]
"""Of one of them alone there are ten images, of which one is the last tenth."""


@pytest.mark.parametrize(
    ("names", "held"),
    [
        ([f"reef/{camera}/{k}" for camera in "abc" for k in range(9)], ["reef/a/8", "reef/b/8", "reef/c/8"]),
        ([f"quadrat{k:02}-2024" for k in range(20)], ["quadrat18-2024", "quadrat19-2024"]),
        ([f"{k:04}/left" for k in range(20)], ["0018/left", "0019/left"]),
        ([f"reef/{camera}/{k}" for camera in "ab" for k in range(4)], []),
        (QUADRATS, QUADRATS[-27:]),
    ],
)
def test_of_few_images_of_each_camera_the_last_of_all_are_kept_back(names, held):
    entries = [Entry(name, "reef", lambda: pytest.fail("it was read"), ()) for name in names]
    assert [entry.name for entry in kept_back(LabelledSet("set", entries))[1].entries] == held


@pytest.mark.parametrize(
    "form", ["%Y-%m-%d_%H-%M-%S", "GX01_%M-%S", "dive/%Y_%m_%d_%H_%M_%S", "reef-%Y-%m-%dT%H-%M-%S"]
)
@pytest.mark.parametrize("clip", ["", "dive"])
def test_of_names_that_hold_a_time_in_parts_the_last_are_kept_back(form, clip):
    """And not those of the last seconds of each minute, or minutes of each hour, between others."""
    start = datetime.datetime(2026, 5, 1, 10, 0)
    for step in (2, 7, 17):
        names = [(start + datetime.timedelta(seconds=step * k)).strftime(form) for k in range(200)]
        entries = [Entry(name, clip or name, lambda: pytest.fail("it was read"), ()) for name in names]
        assert [entry.name for entry in kept_back(LabelledSet("set", entries))[1].entries] == names[-20:]


def test_where_no_clips_are_known_numbers_of_quadrats_are_no_times():
    """Or the last image of each would be held out, and the others of the same ground learnt from."""
    names = [f"q{k:02}-{n:02}" for k in range(1, 31) for n in range(1, 13)]
    entries = [Entry(name, name, lambda: pytest.fail("it was read"), ()) for name in names]
    assert [entry.name for entry in kept_back(LabelledSet("set", entries))[1].entries] == names[-36:]
    cameras = [f"dive{d}-{side}-{n:04}" for d in range(3) for side in ("left", "right") for n in range(100)]
    entries = [Entry(name, name, lambda: pytest.fail("it was read"), ()) for name in cameras]
    held = [entry.name for entry in kept_back(LabelledSet("set", entries))[1].entries]
    assert held == [name for name in cameras if name[-4:] >= "0090"]
