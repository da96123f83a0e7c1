"""Methods of every track run without reach of the truth: hostile ones try every way that leads out of their process."""

from __future__ import annotations

import os
import sys

import cv2
import numpy as np
import pytest

from oysterbench.annotations import open_truth
from oysterbench.methods.adapters import ExternalCommand
from oysterbench.methods.policy_process import PolicyProcess
from oysterbench.methods.sandbox import can_hide
from oysterbench.tracks import TRACKS
from oysterbench.tracks.images import PictureSequence
from tests.helpers.track_runs import finished_of

SECRET = 200  # red of the oysters' masks, which no picture has

HOSTILE = '''
import os, sys
from oysterbench.methods.images import Segmentation
from oysterbench.methods.steering import Steering

SPLITS = {places!r}
MASK = {mask!r}


def words():
    """All that this process is told, or can find out of others."""
    found = [*sys.argv, *os.environ.values(), os.getcwd(), *SPLITS]
    for pid in [p for p in os.listdir("/proc") if p.isdigit()]:
        for name in ("cmdline", "environ"):
            try:
                with open(f"/proc/{{pid}}/{{name}}", "rb") as file:
                    text = file.read()
                found += [word.decode(errors="replace").rpartition("=")[2] for word in text.split(b"\\0")]
            except OSError:
                pass
        for link in ("cwd", "root"):
            found.append(f"/proc/{{pid}}/{{link}}{{SPLITS[0]}}")
        try:
            found += [f"/proc/{{pid}}/fd/{{fd}}" for fd in os.listdir(f"/proc/{{pid}}/fd")]
        except OSError:
            pass
    return found


def opened():
    """Where the mask was read."""
    found = []
    for word in dict.fromkeys(words()):
        for inside in ("", "one.png", "masks/one.png", "secret/masks/one.png", "splits/secret/masks/one.png"):
            place = os.path.join(word, inside) if inside else word
            try:
                if os.path.isfile(place):
                    with open(place, "rb") as file:
                        if file.read(len(MASK)) == MASK:
                            found.append(place)
            except (OSError, ValueError):
                pass
    return found


class Thief:
    name, track = "thief", "segmentation"

    def run(self, images):
        for image in images:
            assert not opened(), opened()
            yield Segmentation(image.name, oyster=image.pixels[..., 0] > 300)


class ThiefPolicy:
    name, track = "thief_policy", "steering"

    def run(self, dive):
        for view in dive:
            assert not opened(), opened()
            yield Steering(view.name, 3, 3)
'''


@pytest.fixture
def labelled(tmp_path, monkeypatch):
    """A folder of labelled pictures in the house of the splits, and a thief that knows where it is."""
    home = tmp_path / "home"
    monkeypatch.setenv("OYSTERBENCH_HOME", str(home))
    place = home / "splits" / "secret"
    for name, value in (("images", 90), ("masks", SECRET)):
        (place / name).mkdir(parents=True)
        assert cv2.imwrite(str(place / name / "one.png"), np.full((24, 32), value, np.uint8))
    (tmp_path / "code").mkdir()
    mask = place / "masks" / "one.png"
    text = HOSTILE.format(places=[str(place), str(home / "splits")], mask=mask.read_bytes())
    (tmp_path / "code" / "hostile.py").write_text(text)
    monkeypatch.chdir(tmp_path / "code")
    monkeypatch.syspath_prepend(str(tmp_path / "code"))
    with open(mask, "rb"):  # this process has it open
        yield place


def run(labelled, tmp_path, method):
    track = TRACKS["segmentation"]
    sequences = [PictureSequence(one, [labelled]) for one in open_truth(labelled)]
    (done,) = finished_of(track, sequences, [method], track.settings({}), tmp_path / "out")
    return done


@pytest.mark.skipif(not can_hide(), reason="needs Landlock: Linux 5.13 or later")
def test_a_method_of_the_segmentation_track_that_tries_to_read_the_truth_from_its_process_cannot(labelled, tmp_path):
    done = run(labelled, tmp_path, "hostile:Thief")
    assert done.failure is None, done.failure
    assert done.outcome.contained
    assert done.scored.record.metrics["iou"] == 0.0


def test_the_thief_would_find_it_in_this_process(labelled):
    """So that the test above can fail."""
    sys.modules.pop("hostile", None)
    import hostile

    found = hostile.opened()
    assert str(labelled / "masks" / "one.png") in found
    assert any(path.startswith(f"/proc/{os.getpid()}/fd/") for path in found)


@pytest.mark.skipif(not can_hide(), reason="needs Landlock: Linux 5.13 or later")
def test_a_policy_that_drives_cannot_open_the_splits(labelled):
    from oysterbench.methods.policy import commands
    from oysterbench.methods.steering import VehicleState, View
    from tests.helpers.exploring_made import made_split

    view = View("000000", np.zeros((24, 32, 3), np.uint8), VehicleState(0.0, 0.0, 2.0, 1.0), 0.0)
    task = made_split().steering
    (made,) = commands(PolicyProcess("hostile:ThiefPolicy"), task, iter([view]), "here")
    assert made[2] == (3, 3)


def test_what_a_method_is_told_does_not_name_the_truth(labelled, tmp_path):
    done = run(labelled, tmp_path, "hostile:Thief")
    told = " ".join(done.outcome.command)
    assert str(labelled) not in told
    assert str(tmp_path / "out") not in told


PROGRAM = """
import os, pathlib, sys
import cv2
given, out = map(pathlib.Path, sys.argv[1:])
names = (given / "images.txt").read_text().split()
out.mkdir()
for name in names:
    picture = cv2.imread(str(given / f"{name}.png"))
    cv2.imwrite(str(out / f"{name}.png"), (picture[..., 0] > 80).astype("uint8") * 255)
"""

LINKS = """
import os, sys
os.symlink(os.environ["PLACE"], sys.argv[2])
"""


def test_a_program_is_given_a_folder_of_pictures_and_leaves_masks(labelled, tmp_path):
    (tmp_path / "code" / "program.py").write_text(PROGRAM)
    command = f"'{sys.executable}' {tmp_path}/code/program.py {{images}} {{out}}"
    adapter = ExternalCommand(command, "mine", "segmentation")
    done = run(labelled, tmp_path, adapter)
    assert done.failure is None, done.failure
    assert done.scored.record.failure is None
    assert done.scored.record.metrics["iou"] == 1.0


def test_a_link_to_the_truth_is_no_prediction(labelled, tmp_path, monkeypatch):
    monkeypatch.setenv("PLACE", str(labelled / "masks"))
    (tmp_path / "code" / "links.py").write_text(LINKS)
    command = f"'{sys.executable}' {tmp_path}/code/links.py {{images}} {{out}}"
    adapter = ExternalCommand(command, "links", "segmentation")
    done = run(labelled, tmp_path, adapter)
    assert "wrote no masks or COCO annotations to {out}" in done.failure
