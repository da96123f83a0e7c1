"""Sequences that lack what a method needs are refused before anything runs."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from oysterbench.core.errors import MethodError
from oysterbench.methods.interfaces.slam import SlamInterface
from oysterbench.methods.systems.adapter import SystemAdapter
from oysterbench.sequence import Sequence
from oysterbench.tracks.slam import SlamSequence


def test_a_folder_is_refused_where_a_file_is_needed(tmp_path):
    with pytest.raises(MethodError, match=r"\{mcap\} needs a sequence file, and this is a folder"):
        SlamInterface().check(SlamSequence("mine", tmp_path), "mcap", {"poses_of": "base"})


def test_a_form_of_pictures_needs_a_camera(tmp_path, monkeypatch):
    blind = SimpleNamespace(name="mine", cameras={})
    monkeypatch.setattr("oysterbench.methods.interfaces.slam.open_sequence", lambda path: blind)
    with pytest.raises(MethodError, match=r"^mine has no camera; the form \{tum\} needs one$"):
        SlamInterface().check(SlamSequence("mine", tmp_path), "tum", {"poses_of": "base"})


def test_a_system_for_two_cameras_is_refused_on_one(tmp_path, monkeypatch):
    one = SimpleNamespace(name="mine", cameras={"cam0": None})
    monkeypatch.setattr("oysterbench.methods.systems.adapter.open_sequence", lambda path: one)
    system = SystemAdapter.__new__(SystemAdapter)
    system.name, system.method = "pair", SimpleNamespace(track="slam", sensors=("stereo",))
    with pytest.raises(MethodError, match="pair: expected a sequence with 2 cameras, got mine with cam0"):
        system.check(SlamSequence("mine", tmp_path))


@pytest.mark.parametrize("contents", [[("imu0", "imu", 0)], [("/cam0/image", "sensor_msgs/msg/Image", 9)]])
def test_an_inertial_system_is_refused_without_inertial_measurements(contents, tmp_path, monkeypatch):
    found = SimpleNamespace(name="mine", cameras={"cam0": None}, contents=lambda: contents)
    found.has_imu = Sequence.has_imu.fget(found)
    monkeypatch.setattr("oysterbench.methods.systems.adapter.open_sequence", lambda path: found)
    system = SystemAdapter.__new__(SystemAdapter)
    system.name, system.method = "inertial[a=1]", SimpleNamespace(track="slam", sensors=("mono", "imu"))
    with pytest.raises(MethodError, match=r"^inertial: expected .* inertial measurements, got mine .* --topics /imu"):
        system.check(SlamSequence("mine", tmp_path))
    system.method.sensors = ("mono",)
    system.check(SlamSequence("mine", tmp_path))
