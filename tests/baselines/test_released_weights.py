"""Trained weights that are part of oysterbench: their cards, and what they see."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.places import released_models
from oysterbench.hub.weights import weights_here
from oysterbench.methods.weights import find_weights
from tests.helpers.paths import ROOT

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

RELEASED = sorted(path.stem for path in released_models().glob("*.pt"))
MEASURED_ON = {"unet": "seg-val", "steering": "steer-val"}
"""Split of the figures on the card of each."""


def test_there_are_some():
    assert set(RELEASED) == set(MEASURED_ON)


@pytest.mark.parametrize("name", RELEASED)
def test_released_weights_are_those_of_their_card(name):
    here = weights_here(released_models() / f"{name}.pt")
    assert here is not None
    assert here.model is not None, "the card is for another file"
    known = find_weights(name)
    assert (here.model.name, here.model.methods) == (name, known.methods)
    assert here.model.training == known.describe(here.path)
    assert {figure.split for figure in here.model.figures} == {MEASURED_ON[name]}
    assert here.path.stat().st_size < 12e6, "a file that everybody downloads with the code"


@pytest.mark.parametrize(("name", "method"), [(name, one) for name in RELEASED for one in find_weights(name).methods])
def test_the_board_ranks_methods_with_the_weights_that_everybody_has(name, method):
    from oysterbench_leaderboard.storage.store import RecordStore

    here = weights_here(released_models() / f"{name}.pt")
    assert here is not None
    found = dict(RecordStore(ROOT / "leaderboard").records_by("oysterbench", method))
    superseded = {record.supersedes for record in found.values()}
    newest = max(
        (one for digest, one in found.items() if one.split == MEASURED_ON[name] and digest not in superseded),
        key=lambda record: record.created,
    )
    assert {str(result.method_settings["weights"][name]) for result in newest.results} == {here.sha256}


def test_released_weights_see_no_oyster_in_an_even_grey_and_that_no_reef_looks_like_it():
    from oysterbench_baselines.unet.model import read_unet

    model = read_unet(released_models() / "unet.pt", torch.device("cpu"), 1, "unet")
    grey = np.full((240, 320, 3), 90, np.uint8)
    seen = model.probabilities(grey)
    assert seen.oyster.shape == (240, 320)
    assert float((seen.oyster > 0.5).mean()) < 0.05, "nothing is in view"
    assert model.novelty_of(grey) > 1


def test_the_weights_of_unet_are_known_to_have_seen_rendered_reefs_alone(tmp_path):
    from oysterbench.counting.accuracy import saw_rendered_reefs_alone

    assert saw_rendered_reefs_alone({"unet": released_models() / "unet.pt"})
    alone = tmp_path / "alone.pt"
    alone.write_bytes((released_models() / "unet.pt").read_bytes())
    assert saw_rendered_reefs_alone({"unet": alone}), "what the checkpoint says, where there is no card"
    (tmp_path / "unet.pt").write_bytes(b"trained by somebody")
    assert not saw_rendered_reefs_alone({"unet": tmp_path / "unet.pt"})
