"""The mask of what moves: what it is learnt from, what it finds, and that no track is kept on it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from functools import partial

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench.annotations import Entry, LabelledImage, LabelledSet  # noqa: E402
from oysterbench.core.errors import LabelError, MethodError  # noqa: E402
from oysterbench.methods.adapters import PythonMethod  # noqa: E402
from oysterbench.recipe import CLASSES, OYSTER  # noqa: E402
from oysterbench_baselines.gtsam_full import GtsamFull  # noqa: E402
from oysterbench_baselines.gtsam_vi import GtsamVi, GtsamViSettings  # noqa: E402
from oysterbench_baselines.gtsam_vi.frontend import FrontEnd  # noqa: E402
from oysterbench_baselines.learning.card import describe  # noqa: E402
from oysterbench_baselines.moving import MovingMask  # noqa: E402
from oysterbench_baselines.moving.labels import moving_set  # noqa: E402
from oysterbench_baselines.moving.training import MovingSettings  # noqa: E402
from oysterbench_baselines.unet.network import UNetworkSettings  # noqa: E402
from oysterbench_baselines.unet.training import train  # noqa: E402
from tests.baselines.test_gtsam_vi_parts import texture  # noqa: E402
from tests.helpers import synthetic_dive as dive  # noqa: E402
from tests.helpers.weights_made import card_of  # noqa: E402

NUMBER = {name: number for number, name in CLASSES.items()}
HEIGHT, WIDTH = 96, 128


def picture(k: int, name: str = "fish") -> LabelledImage:
    """Grey ground with a light oyster and something green."""
    generator = np.random.default_rng(k)
    pixels = generator.integers(60, 90, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    classes = np.full((HEIGHT, WIDTH), NUMBER["bottom"], dtype=np.uint8)
    instances = np.zeros((HEIGHT, WIDTH), dtype=np.uint16)
    for number, (thing, colour) in enumerate((("oyster", (200, 200, 190)), (name, (40, 160, 40))), start=1):
        y, x = generator.integers(0, HEIGHT - 40), generator.integers(0, WIDTH - 40)
        where = slice(y, y + 40), slice(x, x + 40)
        pixels[where], classes[where], instances[where] = colour, NUMBER[thing], number
    return LabelledImage(f"p{k}", "clip", pixels, classes, instances, np.zeros((HEIGHT, WIDTH), dtype=bool))


def pictures(*names: str) -> LabelledSet:
    return LabelledSet("some", [Entry(f"p{k}", "clip", partial(picture, k, name), ()) for k, name in enumerate(names)])


def test_what_moves_takes_the_place_of_oysters():
    found = moving_set(pictures("plant", "fish", "crab", "tether", "stone"))
    assert len(found) == 4  # the picture in which nothing moves is passed over
    for k, image in enumerate(found):
        moves = picture(k).pixels[..., 1] == 160
        np.testing.assert_array_equal(image.classes == OYSTER, moves)
        assert not image.instances.any()


def test_a_set_in_which_nothing_moves_is_refused_in_one_line():
    with pytest.raises(LabelError, match="of 2 images, expected some with plant, fish, crab, tether, got none"):
        moving_set(pictures("stone", "sponge"))


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Of a network that has seen enough to tell green things from light ones."""
    settings = MovingSettings(network=UNetworkSettings(depth=3, base=4, scale=0.5))
    fit = dataclasses.replace(settings.fit, steps=100, learning_rate=3e-2, warm_up=10, threads=1)
    crops = dataclasses.replace(settings.augmentation, crop=64)  # a thing and as much around it
    path = tmp_path_factory.mktemp("moving") / "moving.pt"
    settings = dataclasses.replace(settings, batch=4, augmentation=crops, fit=fit)
    train(moving_set(pictures(*["fish"] * 6)), path, settings, 0, torch.device("cpu"))
    return path


def test_the_mask_is_where_something_moves_and_a_little_around_it(weights):
    mask = MovingMask(str(weights))
    both = either = 0
    for k in range(100, 105):
        shown = picture(k)
        found, moves = mask(shown.pixels), shown.pixels[..., 1] == 160
        assert found.shape == (HEIGHT, WIDTH)
        assert found.dtype == bool
        both, either = both + (found & moves).sum(), either + (found | moves).sum()
    assert both / either > 0.5
    assert mask(picture(1).pixels[..., 0]).shape == (HEIGHT, WIDTH)  # a grey camera


def test_no_track_begins_or_is_kept_on_what_moves():
    covered = np.zeros((480, 640), dtype=bool)
    front_end = FrontEnd(dive.camera_calibration(), GtsamViSettings().frontend, moving=lambda _: covered)
    shown = texture()
    first = front_end.track(shown, np.eye(3))
    covered = np.zeros((480, 640), dtype=bool)
    covered[:, :320] = True
    assert (first.pixels[:, 0] < 320).any()
    second = front_end.track(shown, np.eye(3), 0.1)
    assert len(second.ids) > 20
    assert (second.pixels[:, 0] > 319).all()
    assert np.isin(second.ids, first.ids).any()


@pytest.mark.parametrize("method", [GtsamVi, GtsamFull])
def test_without_weights_it_says_what_to_type(method, tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path))
    monkeypatch.delenv("OYSTERBENCH_MOVING", raising=False)
    assert method(mask="moving").weights == {"moving": tmp_path / "models" / "moving.pt"}
    assert method().weights == {}
    with pytest.raises(
        MethodError, match=r"moving: no trained weights at .*moving\.pt: `oysterbench train moving --data"
    ):
        MovingMask("moving")


def test_weights_that_have_learnt_something_else_are_refused(tmp_path):
    settings = MovingSettings(network=UNetworkSettings(depth=3, base=4, scale=0.5))
    settings = dataclasses.replace(settings, batch=2, fit=dataclasses.replace(settings.fit, steps=1, threads=1))
    train(pictures("fish", "fish"), tmp_path / "unet.pt", settings, 0, torch.device("cpu"))
    with pytest.raises(MethodError, match=r"weights of `oysterbench train moving`, got some .* learnt from some"):
        MovingMask(str(tmp_path / "unet.pt"))


def test_a_release_says_that_they_have_learnt_what_moves(weights):
    described = describe("moving", weights)
    assert list(described.data) == ["moving in some"]
    assert json.loads(card_of(weights, "moving", described).data)["training"]["steps"] == described.steps
    with pytest.raises(MethodError, match="expected weights of unet_small, got those of moving"):
        describe("unet_small", weights)


def test_results_know_the_weights_by_their_content(weights, tmp_path):
    other = tmp_path / "same.pt"
    other.write_bytes(weights.read_bytes())
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    for path in (weights, other):
        assert PythonMethod(f"gtsam_vi[mask={path}]").settings == {"weights": {"moving": digest}}
    assert PythonMethod("gtsam_vi").settings == {}
