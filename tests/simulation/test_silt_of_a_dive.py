"""Silt in a dive: where it is before a camera is in the truth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.scene.plumes import Plumes
from oysterbench.scene.rig import camera_pose
from oysterbench.sensors.camera import KIND
from oysterbench.simulation.simulated_sequence import SimulatedSequence, build_sequence, forget_sequence
from tests.helpers.tiny import TINY_SPLIT, make_split

PLUMES = "plumes = { attenuation = 15.0, bursts_per_100m2_min = 30.0 }"
SITE = "[sequence.site]\ncurrent_m_s = 0.2"
MUDDY = TINY_SPLIT.replace("oysters = 60", 'oysters = 20\nbottom = "mud"')
MUDDY = MUDDY.replace('jerlov = "1C"', f'jerlov = "1C"\n{PLUMES}\n\n{SITE}')


def muddy(salt: bytes = b"") -> tuple[SimulatedSequence, Plumes]:
    forget_sequence()
    simulated = build_sequence(make_split(MUDDY), "tiny-01", salt)
    assert simulated.plumes is not None
    return simulated, simulated.plumes


def test_the_truth_says_when_silt_is_before_a_camera() -> None:
    simulated, plumes = muddy()
    (camera,) = simulated.rig.camera
    (body,) = simulated.bodies(np.array([1.0]))
    ahead = (body @ camera_pose(camera) @ [0.0, 0.0, 0.8, 1.0])[:3]
    drift = plumes._drift(np.array([1.0])) - plumes._drift(np.array([-1.0]))
    one = dataclasses.replace(
        plumes,
        born=np.array([-1.0]),
        place=ahead[None] - np.array([[*drift[0], 0.0]]),
        spread=np.array([0.25]),
        floor=np.array([ahead[2] - 5.0]),
        amount=np.array([2.0]),
    )
    simulated.__dict__["plumes"] = one
    found = KIND.faults(simulated, camera)
    assert [fault.name for fault in found] == ["silt_optical_depth"]
    assert found[0].start_s <= 1.0 <= found[0].end_s
    middle = 2.0 / (2 * np.pi * 0.25**2)
    assert 0.3 * middle < found[0].value < middle
    simulated.__dict__["plumes"] = dataclasses.replace(one, amount=np.array([0.01]))
    assert KIND.faults(simulated, camera) == []
    forget_sequence()


def test_silt_is_the_same_in_every_process_and_another_by_another_salt() -> None:
    (_, one), (_, again), (_, other) = (muddy(salt) for salt in (b"", b"", b"salt"))
    assert np.array_equal(one.place, again.place)
    assert not np.array_equal(one.place[:10], other.place[:10])


@pytest.mark.slow
def test_no_plume_is_thicker_than_asked_when_it_rises() -> None:
    _, plumes = muddy()
    puffs = plumes.at(1.0)
    assert 5.0 < puffs.attenuation(puffs.centre).max() < 1.5 * 15.0


def test_even_water_has_no_silt_in_its_truth() -> None:
    simulated = build_sequence(make_split(), "tiny-01", b"")
    assert KIND.faults(simulated, simulated.rig.camera[0]) == []
    assert simulated.plumes is None


@pytest.fixture(autouse=True)
def _forget():
    yield
    forget_sequence()
