"""No truth is reachable by a method: one tries, by every way that leads out of what it is given."""

from __future__ import annotations

import pytest

import oysterbench
from oysterbench.evaluate.slam.scoring import SlamSettings
from oysterbench.methods import find_method
from oysterbench.sequence.export import export_sequence
from oysterbench.tracks.slam import TRACK, SlamSequence, own_sequences
from tests.helpers.track_runs import finished_of

BURGLAR = '''
import gc
import os
import pathlib
import sys

import numpy as np

import oysterbench
from oysterbench.core.errors import OysterbenchError
from oysterbench.methods import Estimate
from oysterbench.sequence import Sequence
from oysterbench.core.trajectory import Trajectory

TOPICS = ("/tf", "/depth", "/class", "/instance", "/cloud")


class Burglar:
    """Looks for the truth wherever an object, a name or an open file leads, and says what it found."""

    name, track = "burglar", "slam"

    def run(self, sequence):
        images = sequence.images(next(iter(sequence.cameras)))
        next(images)  # a file is open now
        found, places = [], set()
        for thing in gc.get_objects():  # closures, private attributes, bound methods: whatever refers to anything
            if issubclass(type(thing), Sequence):  # isinstance would ask objects that answer with warnings
                found += self.look_into(thing)
                places |= {str(getattr(thing, key)) for key in ("path", "folder", "_root") if hasattr(thing, key)}
        words = [*sys.argv, *os.environ.values(), os.getcwd(), *places]
        for number in os.listdir("/proc/self/fd"):
            try:
                words.append(os.readlink(f"/proc/self/fd/{number}"))
            except OSError:
                continue
        for word in words:
            if word.endswith(".mcap"):
                places.add(word)
                found += self.look_into(oysterbench.open(word))
            for place in (word, os.path.dirname(word)):
                for folder in (place, os.path.dirname(place)):
                    if os.path.isdir(os.path.join(folder, "mav0")):
                        places.add(folder)
                        found += [("file", str(path)) for path in pathlib.Path(folder).rglob("*truth*")]
        stamps = np.array([sample.stamp_ns for sample in sequence.imu()])
        still = Trajectory(stamps, np.zeros((len(stamps), 3)), np.tile([0.0, 0, 0, 1], (len(stamps), 1)))
        return Estimate(still, {"found": found, "places": sorted(places)})

    def look_into(self, thing):
        found = []
        for call in ("truth", "oysters"):
            try:
                found.append((call, len(getattr(thing, call)())))
            except OysterbenchError:
                continue
        found += [("attachment", key) for key in getattr(thing, "attachments", {}) if "calib" not in key]
        found += [("metadata", key) for key in thing.metadata if "digest" in key or "seed" in key]
        topics = [topic for topic, _, _ in thing.contents()]
        return found + [("topic", topic) for topic in topics if "truth" in topic or topic.endswith(TOPICS)]
'''


@pytest.fixture
def burglar(tmp_path, monkeypatch):
    (tmp_path / "burglary.py").write_text(BURGLAR)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return "burglary:Burglar"


def only_run(dive, reference, tmp_path):
    """What the method says of itself."""
    (done,) = finished_of(TRACK, [dive], [reference], SlamSettings(), tmp_path / "out")
    assert done.outcome.failure is None, done.outcome.failure
    return done.outcome.info


def test_what_a_method_is_given_leads_to_no_truth(burglar, dive_file, tmp_path):
    info = only_run(SlamSequence("hand-made", dive_file), burglar, tmp_path)
    assert info["found"] == []
    # It got to the file under the view, and that is one from which the truth was cut.
    (place,) = info["places"]
    assert place.endswith("/hand-made.mcap")
    assert not place.startswith((str(tmp_path), str(dive_file.parent)))


def test_an_euroc_folder_is_given_without_its_truth(burglar, dive_file, tmp_path):
    folder, _ = export_sequence(oysterbench.open(dive_file), "euroc", tmp_path / "elsewhere" / "flight")
    assert list(folder.rglob("*truth*"))
    (dive,) = own_sequences([folder])
    info = only_run(dive, burglar, tmp_path)
    assert info["found"] == []
    assert any(place.endswith("/flight") for place in info["places"])
    assert not any("elsewhere" in place for place in info["places"])


def test_the_burglar_finds_what_is_there(burglar, dive_file):
    """In this process, where methods are tried out, the view hides the truth and does not lock it away."""
    info = find_method(burglar).run(oysterbench.open(dive_file).for_method()).info
    assert {kind for kind, _ in info["found"]} >= {"truth", "topic"}
