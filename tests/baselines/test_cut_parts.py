"""The parts of the translation: losses against hand-written references, named layers, colours, drift, pictures."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import cv2  # noqa: E402

from oysterbench.annotations import Entry, LabelledImage, LabelledSet  # noqa: E402
from oysterbench.core.errors import LabelError, MethodError  # noqa: E402
from oysterbench.core.streams import stream  # noqa: E402
from oysterbench.recipe import OYSTER  # noqa: E402
from oysterbench_baselines.cut.colour import (  # noqa: E402
    TRANSFERS,
    lab,
    match_histograms,
    match_reinhard,
    recoloured,
)
from oysterbench_baselines.cut.drift import mask_drift  # noqa: E402
from oysterbench_baselines.cut.losses import looks, patch_nce  # noqa: E402
from oysterbench_baselines.cut.networks import (  # noqa: E402
    Discriminator,
    Generator,
    Grow,
    Projections,
    Shrink,
)
from oysterbench_baselines.cut.pictures import as_picture, as_tensor, draw_crop, read_pictures  # noqa: E402
from oysterbench_baselines.cut.settings import CutSettings, settings_of  # noqa: E402
from oysterbench_baselines.cut.translation import translate  # noqa: E402

TINY = CutSettings(
    filters=4, blocks=2, discriminator_filters=4, crop=32, layers=("pixels", "conv2", "block2"), patches=16, width=8
)


if TYPE_CHECKING:
    from torch import Tensor


def tensor(*shape: int, seed: int = 0) -> Tensor:
    return torch.from_numpy(stream(seed, b"", "tensor").standard_normal(shape).astype(np.float32))


def reef(seed: int, size: int = 96) -> tuple[np.ndarray, np.ndarray]:
    """A picture of bright ellipses on dark, noisy ground, and their mask."""
    rng = stream(seed, b"", "reef")
    mask = np.zeros((size, size), np.uint8)
    for _ in range(5):
        centre = [int(v) for v in rng.integers(15, size - 15, 2)]
        axes = [int(v) for v in rng.integers(8, 16, 2)]
        cv2.ellipse(mask, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
    ground = rng.normal(0, 6, (size, size, 3)) + [70, 90, 60] + mask[..., None] * [60, 50, 55]
    return np.clip(cv2.GaussianBlur(ground, (0, 0), 0.8), 0, 255).astype(np.uint8), mask > 0


def labelled(count: int, name: str = "reef", tint: float = 0.0, size: int = 96, clips: int = 1) -> LabelledSet:
    """A set of such pictures, bluer by `tint`."""

    def read(k: int) -> LabelledImage:
        pixels, mask = reef(k, size)
        pixels = np.clip(pixels + np.array([0, 0, tint]), 0, 255).astype(np.uint8)
        instances, classes = mask.astype(np.uint16), (mask * OYSTER).astype(np.uint8)
        return LabelledImage(f"{name}-{k}", f"clip-{k % clips}", pixels, classes, instances, ~mask & False)

    return LabelledSet(name, [Entry(f"{name}-{k}", f"clip-{k % clips}", partial(read, k), ()) for k in range(count)])


def test_patch_nce_is_the_cross_entropy_written_out_patch_by_patch():
    queries = {"a": torch.nn.functional.normalize(tensor(2, 5, 7), dim=2)}
    keys = {"a": torch.nn.functional.normalize(tensor(2, 5, 7, seed=1), dim=2)}
    tau = 0.07
    expected = []
    for q, k in zip(queries["a"].numpy().astype(float), keys["a"].numpy().astype(float), strict=True):
        for i in range(5):
            scores = [np.dot(q[i], k[j]) / tau for j in range(5)]
            expected.append(np.log(np.sum(np.exp(np.array(scores) - max(scores)))) + max(scores) - scores[i])
    assert float(patch_nce(queries, keys, tau)) == pytest.approx(np.mean(expected), rel=1e-5)


def test_patch_nce_is_the_mean_over_layers_and_sends_no_gradient_into_the_keys():
    a, b = (torch.nn.functional.normalize(tensor(1, 6, 4, seed=k), dim=2) for k in (0, 1))
    q = {"one": a.clone().requires_grad_(), "two": b.clone().requires_grad_()}
    k = {"one": b.clone().requires_grad_(), "two": b.clone().requires_grad_()}
    loss = patch_nce(q, k, 0.1)
    single = [float(patch_nce({n: q[n]}, {n: k[n]}, 0.1).detach()) for n in q]
    assert float(loss.detach()) == pytest.approx(np.mean(single), rel=1e-6)
    loss.backward()
    assert all(values.grad is not None for values in q.values())
    assert all(values.grad is None for values in k.values())


def test_patch_nce_of_a_picture_with_itself_is_least():
    a, b = (torch.nn.functional.normalize(tensor(1, 32, 16, seed=k), dim=2) for k in (0, 1))
    assert float(patch_nce({"a": a}, {"a": a}, 0.07)) < 0.1 < float(patch_nce({"a": a}, {"a": b}, 0.07))


def test_looks_is_the_squared_distance_from_what_a_verdict_should_be():
    verdicts = torch.tensor([0.0, 1.0, 3.0])
    assert float(looks(verdicts, True)) == pytest.approx((1 + 0 + 4) / 3)
    assert float(looks(verdicts, False)) == pytest.approx((0 + 1 + 9) / 3)


def test_shrinking_passes_no_pattern_that_the_small_picture_cannot_hold():
    stripes = torch.ones(1, 2, 16, 16)
    stripes[..., ::2] = -1
    assert float(Shrink(2)(stripes).abs().max()) < 1e-6
    assert torch.allclose(Shrink(2)(torch.full((1, 2, 16, 16), 3.0)), torch.full((1, 2, 8, 8), 3.0))


def test_growing_is_the_filter_1_3_3_1_between_zeros():
    values = tensor(1, 1, 6, 6)
    line = torch.tensor([1.0, 3.0, 3.0, 1.0]) / 4
    kernel = (line[:, None] * line)[None, None]
    padded = torch.nn.functional.pad(values, (1, 1, 1, 1), mode="replicate")
    reference = torch.nn.functional.conv_transpose2d(padded, kernel, stride=2, padding=1)[..., 2:-2, 2:-2]
    assert torch.allclose(Grow()(values), reference, atol=1e-6)


def test_encoder_layers_go_by_their_names_and_stop_at_the_last_one_wanted():
    torch.manual_seed(0)
    generator = Generator(TINY)
    pixels = tensor(1, 3, 32, 32).clamp(-1, 1)
    found = generator.encode(pixels, ("pixels", "conv1", "conv2", "block1", "block2"))
    shapes = {name: tuple(values.shape[1:]) for name, values in found.items()}
    assert shapes == {
        "pixels": (3, 32, 32),
        "conv1": (8, 32, 32),
        "conv2": (16, 16, 16),
        "block1": (16, 8, 8),
        "block2": (16, 8, 8),
    }
    assert {name: generator.channels(name) for name in found} == {name: shape[0] for name, shape in shapes.items()}
    ran = []
    generator.blocks[1].register_forward_hook(lambda *_: ran.append("block2"))
    generator.encode(pixels, ("conv1", "block1"))
    assert not ran
    generator(pixels)
    assert ran == ["block2"]


def test_projections_are_there_before_the_first_picture_and_give_unit_vectors():
    generator = Generator(TINY)
    heads = Projections(generator, TINY)
    assert set(heads) == set(TINY.layers)
    assert len(list(heads.parameters())) == 4 * len(TINY.layers)
    layers = generator.encode(tensor(1, 3, 32, 32).clamp(-1, 1), TINY.layers)
    places = {name: torch.arange(16) for name in layers}
    for values in heads(layers, places).values():
        assert values.shape == (1, 16, 8)
        assert torch.allclose(values.norm(dim=2), torch.ones(1, 16), atol=1e-5)


def test_each_verdict_sees_70_pixels():
    """Without normalisation, which sees everything: the pixels that move one verdict."""
    torch.manual_seed(0)
    judge = Discriminator(TINY)
    for k, layer in enumerate(judge):
        if isinstance(layer, torch.nn.InstanceNorm2d):
            judge[k] = torch.nn.Identity()
    pixels = torch.zeros(1, 3, 192, 192, requires_grad=True)
    verdicts = judge(pixels + tensor(1, 3, 192, 192))
    middle = verdicts.shape[2] // 2
    verdicts[0, 0, middle, middle].backward()
    rows = torch.nonzero(pixels.grad.abs().sum(dim=(0, 1, 3))).flatten()
    assert 70 <= int(rows[-1] - rows[0]) + 1 <= 90, "70 px, and the low-pass filters' margin"


def test_a_generator_that_changes_its_input_begins_with_the_picture_itself():
    torch.manual_seed(0)
    settings = replace(TINY, skip=True, scale=0.5)
    generator = Generator(settings).eval()
    picture = reef(3, 97)[0]
    found = translate(generator, settings, picture)
    assert found.shape == picture.shape, "at its own size, of which 4 is no divisor"
    assert np.abs(found.astype(int) - picture).mean() < 3


def test_pixels_come_back_from_tensors():
    picture = reef(0)[0]
    assert np.array_equal(as_picture(as_tensor(picture)), picture)


def test_crops_lie_inside_and_come_mirrored_half_the_time():
    picture = np.zeros((40, 50, 3), np.uint8)
    picture[..., 0] = np.arange(50)
    steps = []
    for k in range(60):
        crop = as_picture(draw_crop([picture], 32, stream(0, b"", k)))
        assert crop.shape == (32, 32, 3)
        steps.append(int(crop[0, 1, 0]) - int(crop[0, 0, 0]))
    assert set(steps) == {-1, 1}
    assert 15 < steps.count(1) < 45


def test_histogram_matching_gives_the_levels_of_the_model():
    picture, model = reef(0)[0], reef(1, 80)[0][..., ::-1]
    found = match_histograms(picture, np.ascontiguousarray(model))
    for channel in range(3):
        wanted = np.quantile(model[..., channel], [0.05, 0.2, 0.4, 0.95])
        assert np.quantile(found[..., channel], [0.05, 0.2, 0.4, 0.95]) == pytest.approx(wanted, abs=3)
    assert np.abs(match_histograms(picture, picture).astype(int) - picture).max() <= 1


def test_reinhard_gives_mean_and_spread_of_the_model():
    picture, model = reef(0)[0], np.ascontiguousarray(reef(1)[0][..., ::-1])
    found, wanted = lab(match_reinhard(picture, model)), lab(model)
    assert found.mean(axis=(0, 1)) == pytest.approx(wanted.mean(axis=(0, 1)), abs=1.0)
    assert found.std(axis=(0, 1)) == pytest.approx(wanted.std(axis=(0, 1)), rel=0.1, abs=0.3)
    assert np.abs(match_reinhard(picture, picture).astype(int) - picture).max() <= 1


@pytest.mark.parametrize("name", TRANSFERS)
def test_recolouring_leaves_labels_alone_and_depends_on_the_name_only(name):
    models = labelled(6, "real", tint=60, clips=3)
    images = labelled(4)
    once = list(recoloured(images, models, TRANSFERS[name]))
    again = list(recoloured([images[k] for k in (3, 1)], models, TRANSFERS[name]))
    assert np.array_equal(once[3].pixels, again[0].pixels)
    assert np.array_equal(once[1].pixels, again[1].pixels)
    assert np.array_equal(once[0].classes, images[0].classes)
    assert once[0].pixels[..., 2].mean() > images[0].pixels[..., 2].mean() + 30


def test_recolouring_without_a_model_is_refused():
    with pytest.raises(LabelError, match="at least one image to take colours from"):
        list(recoloured(labelled(2), labelled(0, "none"), match_reinhard))


def test_colours_alone_are_no_drift():
    picture, mask = reef(0)
    found = mask_drift(picture, match_reinhard(picture, np.ascontiguousarray(reef(1)[0][..., ::-1])), mask)
    assert found.edges > 0.9
    assert found.kept > 0.9
    assert found.flow < 0.3
    assert found.offset == 0


@pytest.mark.parametrize("shift", [2, 5])
def test_a_moved_picture_has_drifted_by_as_much(shift):
    picture, mask = reef(0, 128)
    moved = np.roll(picture, shift, axis=1)
    still, found = mask_drift(picture, picture, mask), mask_drift(picture, moved, mask)
    assert still.edges == pytest.approx(1)
    assert (still.flow, still.offset) == (0, 0)
    assert found.edges < still.edges - 0.2
    assert found.flow == pytest.approx(shift, abs=1.0)
    assert found.offset == pytest.approx(shift, abs=1)


def test_pictures_without_a_border_say_nothing_of_drift():
    picture = reef(0)[0]
    assert np.isnan(mask_drift(picture, picture, np.zeros(picture.shape[:2], bool)).edges)
    assert np.isnan(mask_drift(picture, picture, np.ones(picture.shape[:2], bool)).flow)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"layers": ("block5",)}, "a generator of 2 blocks has no such layer; it has pixels, conv1, conv2, block1"),
        ({"crop": 30}, "expected a multiple of 4"),
        ({"scale": 0.0}, "above 0 and up to 1"),
    ],
)
def test_settings_that_cannot_be_are_named(change, message):
    with pytest.raises(MethodError, match=message):
        replace(TINY, **change)


def test_fastcut_is_cut_with_more_weight_on_content_no_identity_and_mirrors():
    cut, fast = (settings_of(name, "full") for name in ("cut", "fastcut"))
    assert (cut.nce_weight, cut.identity, cut.flip) == (1.0, True, False)
    assert (fast.nce_weight, fast.identity, fast.flip) == (10.0, False, True)
    assert replace(fast, nce_weight=1.0, identity=True, flip=False) == cut
    with pytest.raises(MethodError, match="expected cut or fastcut"):
        settings_of("cyclegan", "full")
    with pytest.raises(MethodError, match="expected one of full, small"):
        settings_of("cut", "huge")


def test_the_learning_rate_falls_in_the_second_half():
    settings = replace(TINY, steps=100, learning_rate=1.0)
    assert [settings.rate(k) for k in (0, 50, 75, 99)] == pytest.approx([1, 1, 0.5, 0.02])


def test_too_few_pictures_are_refused_with_their_number():
    with pytest.raises(LabelError, match=r"few: expected at least 20 images.*got 19"):
        read_pictures(labelled(19, "few"), 32, 1.0)


def test_a_picture_smaller_than_a_crop_is_named():
    with pytest.raises(LabelError, match=r"reef-0: expected at least 192 px.*got 96 x 96"):
        read_pictures(labelled(20), 96, 0.5)


def test_an_empty_picture_is_named():
    good = labelled(19)
    blank = replace(good[0], name="blank", pixels=np.full((96, 96, 3), 7, np.uint8))
    with pytest.raises(LabelError, match="blank: every pixel is 7"):
        read_pictures(LabelledSet("some", [*good.entries, Entry("blank", "c", lambda: blank, ())]), 32, 1.0)
