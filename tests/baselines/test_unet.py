"""The U-Net: sizes, tiles, and what a user sees where it was never trained."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from click.testing import CliRunner  # noqa: E402

from oysterbench.annotations import Entry, LabelledImage, LabelledSet, open_labelled  # noqa: E402
from oysterbench.cli.main import main  # noqa: E402
from oysterbench.core.errors import MethodError  # noqa: E402
from oysterbench.methods import find_method  # noqa: E402
from oysterbench.methods.images import Picture  # noqa: E402
from oysterbench.recipe import OYSTER  # noqa: E402
from oysterbench_baselines.learning import masks  # noqa: E402
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint  # noqa: E402
from oysterbench_baselines.learning.efficientnet import weights_file  # noqa: E402
from oysterbench_baselines.learning.masks import enlarged, probability  # noqa: E402
from oysterbench_baselines.unet import UNet, UNetSmall, UNetSmallInstances, network  # noqa: E402
from oysterbench_baselines.unet.calibration import Calibration, kept_back, measured  # noqa: E402
from oysterbench_baselines.unet.instances import find_instances  # noqa: E402
from oysterbench_baselines.unet.model import UNetModel, read_unet  # noqa: E402
from oysterbench_baselines.unet.network import UNetwork, UNetworkSettings, build_network  # noqa: E402
from oysterbench_baselines.unet.training import new_network, train  # noqa: E402
from oysterbench_baselines.unet.views import Look  # noqa: E402
from tests.helpers.labelled_folders import image  # noqa: E402
from tests.helpers.small_trainings import SMALL, small_set  # noqa: E402


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """A network that has seen enough of the small pictures to tell light oysters from dark ground."""
    folder = tmp_path_factory.mktemp("unet")
    labelled = small_set(folder / "small", {"one": ("train", 6)})
    fit = dataclasses.replace(SMALL.fit, steps=150, learning_rate=1e-2)
    train(labelled, folder / "unet.pt", dataclasses.replace(SMALL, fit=fit), 0, torch.device("cpu"))
    return folder / "unet.pt"


def test_it_learns_what_it_is_shown_and_finds_it_in_pictures_it_has_not_seen(checkpoint):
    pictures = [image(k, height=64, width=80) for k in range(100, 106)]
    method = UNetSmall(str(checkpoint), "cpu")
    both = either = 0
    for one, predicted in zip(pictures, method.run(Picture(p.name, p.pixels) for p in pictures), strict=True):
        assert predicted.name == one.name
        assert predicted.probability.shape == (64, 80)
        found = predicted.probability >= 0.5
        both, either = both + (found & one.oysters).sum(), either + (found | one.oysters).sum()
    assert both / either > 0.6


def test_oysters_one_by_one_have_scores_and_lie_apart(checkpoint):
    one = image(101, height=64, width=80)
    (predicted,) = UNetSmallInstances(str(checkpoint), "cpu").run([Picture("a", one.pixels)])
    assert predicted.numbers.max() == len(predicted.scores) > 0
    assert ((predicted.scores > 0.5) & (predicted.scores <= 1)).all()


def test_the_network_keeps_the_size_and_has_two_answers():
    small = UNetwork(UNetworkSettings(depth=4, base=4))
    assert small(torch.zeros(2, 3, 32, 48)).shape == (2, 2, 32, 48)
    assert sum(p.numel() for p in UNetwork(UNetworkSettings()).parameters()) == 482_754


def test_a_network_on_an_encoder_keeps_the_size_and_has_two_answers():
    settings = UNetworkSettings(groups=8, encoder="lite0", side=320)
    network = build_network(settings).eval()
    with torch.inference_mode():
        assert network(torch.zeros(2, 3, 64, 96)).shape == (2, 2, 64, 96)
    assert settings.multiple == 32


def test_an_encoder_begins_with_what_it_has_learnt_and_goes_on_with_what_it_was_taught():
    try:
        file = weights_file("lite0")
    except MethodError as error:
        pytest.skip(str(error))
    settings = UNetworkSettings(groups=8, encoder="lite0")
    begun = new_network(settings)
    first = next(iter(torch.load(file, weights_only=True).values()))
    assert torch.equal(begun.encoder.stem[0].weight, first)
    with torch.no_grad():
        begun.encoder.stem[0].weight += 1.0
    gone_on = new_network(settings, Checkpoint({}, {}, begun.state_dict(), {}, {}, 0, False, [], 0.0, {}))
    assert torch.equal(gone_on.encoder.stem[0].weight, first + 1.0)


def test_a_network_on_an_encoder_learns_and_is_read_again(tmp_path, monkeypatch):
    """From random weights: none need be installed."""
    monkeypatch.setattr(network, "pretrained", network.EfficientNetLite)
    labelled = small_set(tmp_path / "small", {"one": ("train", 6)})
    settings = dataclasses.replace(
        SMALL,
        network=UNetworkSettings(groups=8, encoder="lite0", side=64),
        augmentation=dataclasses.replace(SMALL.augmentation, crop=64),
        fit=dataclasses.replace(SMALL.fit, steps=10, learning_rate=1e-3),
    )
    found = train(labelled, tmp_path / "unet.pt", settings, 0, torch.device("cpu"))
    assert np.mean(found.losses[-3:]) < np.mean(found.losses[:3])
    model = read_unet(tmp_path / "unet.pt")
    assert model.small_logits(np.zeros((100, 200, 3), np.uint8)).shape == (2, 32, 64)
    assert model.logits(np.zeros((100, 200, 3), np.uint8)).shape == (2, 100, 200)


def test_what_the_encoder_normalises_by_is_not_learnt_and_its_weights_are(monkeypatch):
    monkeypatch.setattr(network, "pretrained", network.EfficientNetLite)
    found = build_network(UNetworkSettings(groups=8, encoder="lite0", side=64), begun=True)
    before = {key: value.clone() for key, value in found.state_dict().items()}
    found.train()
    optimiser = torch.optim.SGD(found.parameters(), lr=0.1)
    found(torch.randn(2, 3, 64, 64)).square().mean().backward()
    optimiser.step()
    changed = {key for key, value in found.state_dict().items() if not torch.equal(value, before[key])}
    assert not any("running" in key or "batches" in key for key in changed)
    assert any(key.startswith("encoder.stem") for key in changed)


@pytest.mark.parametrize("size", [(64, 80), (61, 83), (5, 7)])
def test_pictures_of_any_size_are_answered_at_their_size(size, checkpoint):
    pixels = np.random.default_rng(0).integers(0, 255, (*size, 3), dtype=np.uint8)
    assert read_unet(checkpoint).logits(pixels).shape == (2, *size)


def test_a_large_picture_in_parts_is_answered_everywhere_and_almost_as_the_whole(checkpoint, monkeypatch):
    """Parts are normalised each by itself, so that they differ a little from the whole; the seams do not show."""
    one = image(7, height=192, width=256)
    found = read_unet(checkpoint)
    whole = found.logits(one.pixels)[0]
    monkeypatch.setattr(masks, "LARGEST_TILE", 64)
    monkeypatch.setattr(masks, "MARGIN", 16)
    parts = found.logits(one.pixels)[0]
    assert ((whole > 0) == (parts > 0)).mean() > 0.95
    spans = [inner for _, inner in masks._parts(200)]
    assert spans[0].start == 0
    assert spans[-1].stop == 200
    assert all(a.stop == b.start for a, b in pairwise(spans))


def test_enlarged_logits_keep_their_place():
    """A step in the middle stays in the middle: corners of pixels lie on corners of pixels."""
    small = np.where(np.arange(8) < 4, -1.0, 1.0).astype(np.float32)
    large = enlarged(np.broadcast_to(small, (1, 4, 8)), 16, 32)[0]
    assert np.array_equal(large[3] > 0, np.arange(32) >= 16)


# What is measured at the end of a training


def test_one_picture_in_ten_of_a_clip_its_last_is_kept_back_and_none_where_there_are_few(tmp_path):
    labelled = small_set(tmp_path / "set", {"long": ("", 23), "short": ("", 4)})
    learnt_from, kept = kept_back(labelled)
    assert [entry.name for entry in kept.entries] == ["long-21", "long-22"]
    assert len(learnt_from) == 25
    few = small_set(tmp_path / "few", {"short": ("", 4)})
    assert [len(part) for part in kept_back(few)] == [4, 0]


@pytest.mark.parametrize("mark", ["/", "-", "_"])
def test_of_a_clip_of_two_cameras_the_same_instants_of_both_are_kept_back(mark):
    names = [f"reef/{camera}{mark}{k}" for camera in ("down", "close") for k in range(40)]
    names += [f"reef/slow{mark}{k}" for k in range(0, 40, 2)]
    entries = [Entry(name, "reef", lambda: pytest.fail("it was read"), ()) for name in names]
    learnt_from, kept = kept_back(LabelledSet("set", entries))
    assert {entry.name for entry in kept.entries} == {
        *(f"reef/{camera}{mark}{k}" for camera in ("down", "close") for k in range(36, 40)),
        *(f"reef/slow{mark}36", f"reef/slow{mark}38"),
    }
    assert len(learnt_from) + len(kept) == len(entries)


def test_the_cut_is_where_iou_is_greatest_and_becomes_a_probability_of_a_half(tmp_path):
    labelled = small_set(tmp_path / "set", {"one": ("", 6)})
    truths = [entry.read() for entry in labelled.entries]
    rng = np.random.default_rng(0)
    said = [np.where(one.oysters, 2.0, 0.0) + rng.normal(0, 1.0, one.oysters.shape) for one in truths]

    def look(pixels):
        k = next(k for k, one in enumerate(truths) if np.array_equal(one.pixels, pixels))
        return Look(np.stack([said[k], 4.0 * truths[k].oysters - 2.0]).astype(np.float32))

    def iou(cut):
        found = [(logits > cut, one.oysters) for logits, one in zip(said, truths, strict=True)]
        return sum((a & b).sum() for a, b in found) / sum((a | b).sum() for a, b in found)

    found = measured(labelled, look)
    assert found.cut > 0.5
    assert iou(found.cut) > max(iou(found.cut - 0.5), iou(found.cut + 0.5))
    assert iou(found.cut) > iou(0) + 0.05
    logits = np.array([found.cut - 1, found.cut, found.cut + 1], dtype=np.float32)
    assert np.sign(found.applied(logits)).tolist() == [-1, 0, 1]


def pairs_of_oysters(depth_between, bump):
    """A set of two oysters that touch, and what is said of it: depth sinks to `depth_between` where they do, and each
    has two summits that stand out by `bump`."""
    y, x = np.mgrid[:48, :96]
    numbers = np.where((abs(y - 24) < 12) & (abs(x - 48) < 36), np.where(x < 48, 1, 2), 0).astype(np.uint16)
    within = np.where(numbers == 1, x - 13, x - 48) / 35
    depth = np.where(numbers > 0, 0.8 - bump * np.cos(4 * np.pi * within).clip(0), 0)
    depth[(numbers > 0) & (abs(x - 47.5) < 4)] = depth_between
    classes = np.where(numbers > 0, OYSTER, 0).astype(np.uint8)
    empty = np.zeros(numbers.shape, np.uint8)
    one = LabelledImage("a", "", np.stack([empty] * 3, axis=-1), classes, numbers, empty > 0)
    said = np.stack([np.where(numbers > 0, 3.0, -3.0), np.log(depth.clip(0.01, 0.99) / (1 - depth.clip(0.01, 0.99)))])
    return LabelledSet("pairs", [Entry("a", "", lambda: one, ())]), said.astype(np.float32)


@pytest.mark.parametrize(
    ("depth_between", "bump", "least", "most"), [(0.73, 0.01, 0.04, 0.06), (0.5, 0.11, 0.12, 0.15)]
)
def test_oysters_are_told_apart_by_the_rise_that_finds_most_of_the_true_ones(depth_between, bump, least, most):
    labelled, said = pairs_of_oysters(depth_between, bump)
    steps = []
    found = measured(labelled, lambda pixels: Look(said), lambda done, total: steps.append((done, total)))
    assert least <= found.rise <= most
    oyster, depth = said
    instances = find_instances(probability(found.applied(oyster)), probability(depth), found.division)
    assert (instances.scores >= 0.5).sum() == 2
    assert steps == [(k, 10) for k in range(1, 11)]


def alive(labelled):
    """Every other oyster of a set is."""

    def told(entry):
        def read():
            one = entry.read()
            return dataclasses.replace(one, living={int(k): k % 2 == 0 for k in np.unique(one.instances)})

        return dataclasses.replace(entry, read=read)

    return LabelledSet(labelled.name, map(told, labelled.entries))


@pytest.mark.parametrize(("noise", "tells"), [(0.3, True), (30.0, False)])
def test_live_oysters_are_told_from_dead_ones_where_pictures_kept_back_say_that_it_can_be(tmp_path, noise, tells):
    labelled = alive(small_set(tmp_path / "set", {"one": ("", 12)}))
    truths = [entry.read() for entry in labelled.entries]
    rng = np.random.default_rng(0)

    def look(pixels):
        one = next(one for one in truths if np.array_equal(one.pixels, pixels))
        oyster = 4.0 * one.oysters - 2.0
        shift = rng.normal(0, noise, one.instances.max() + 1)  # each oyster has its own
        live = np.where(one.instances % 2 == 0, 1.0, -1.0) + shift[one.instances] + 3.0
        return Look(np.stack([oyster, oyster, live]).astype(np.float32))

    found = measured(labelled, look)
    assert found.tells is tells
    if tells:
        assert found.states > 0.95
        assert found.live_cut == pytest.approx(3.0, abs=0.8)
    silent = measured(small_set(tmp_path / "other", {"one": ("", 6)}), lambda p: Look(np.zeros((3, *p.shape[:2]))))
    assert (silent.states, silent.tells) == (0, False)


def test_a_network_that_tells_says_of_each_oyster_whether_it_is_alive(tmp_path):
    labelled = alive(small_set(tmp_path / "small", {"one": ("train", 6)}))
    settings = dataclasses.replace(SMALL, network=dataclasses.replace(SMALL.network, states=True))
    settings = dataclasses.replace(settings, fit=dataclasses.replace(SMALL.fit, steps=60, learning_rate=1e-2))
    path = tmp_path / "unet.pt"
    known = train(labelled, path, settings, 0, torch.device("cpu"))
    one = image(101, height=64, width=80)
    for states in (0.9, 0.5):
        known.measured["calibration"]["states"] = states
        known.write(path)
        (predicted,) = UNetSmallInstances(str(path), "cpu").run([Picture("a", one.pixels)])
        if states > 0.65:
            assert len(predicted.live) == len(predicted.scores) > 0
            assert ((predicted.live >= 0) & (predicted.live <= 1)).all()
        else:
            assert predicted.live is None


def test_where_nothing_was_kept_back_nothing_is_changed(tmp_path):
    nothing = small_set(tmp_path / "set", {"one": ("", 2)}).where(lambda entry: False)
    assert measured(nothing, lambda pixels: Look(np.zeros((2, *pixels.shape[:2]), np.float32))) == Calibration()


def test_what_was_measured_is_in_the_checkpoint_and_measured_once(checkpoint):
    known = read_checkpoint(checkpoint)
    assert set(known.measured) == {"calibration"}, "a small network knows nothing of what pictures are like"
    assert read_unet(checkpoint).calibration == Calibration(**known.measured["calibration"])
    assert read_unet(checkpoint).novelty_of(image(3).pixels) is None


def test_every_view_is_laid_over_the_picture_as_it_is():
    """Of a network that gives back its pixels, the mean of views is these: of a picture unlike its own turns."""

    class Same(torch.nn.Module):
        def forward(self, pixels):
            return pixels[:, :2]

    rows, columns = np.mgrid[0:60, 0:90]
    pixels = np.stack([2 * columns, 4 * rows, rows + columns], axis=-1).astype(np.uint8)
    model = UNetModel(Same(), 1.0, 1, torch.device("cpu"))
    alone = model.look(pixels).logits
    for views in (2, 3, 4):
        model.views = views
        assert np.abs(model.look(pixels).logits - alone).max() < 0.05


def test_more_views_are_their_mean(checkpoint):
    pixels = image(5, height=64, width=80).pixels
    one, two, three = (read_unet(checkpoint, views=n) for n in (1, 2, 3))
    mirrored = one.look(np.ascontiguousarray(pixels[:, ::-1])).logits[..., ::-1]
    assert np.allclose(three.look(pixels).logits, (2 * two.look(pixels).logits + mirrored) / 3, atol=1e-5)
    assert not np.allclose(two.look(pixels).logits, one.look(pixels).logits, atol=1e-3)
    with pytest.raises(MethodError, match="unet: views: expected 1 to 4, got 5"):
        UNet(views=5)


def test_weights_of_the_other_training_are_refused(checkpoint):
    with pytest.raises(
        MethodError, match="expected weights of `oysterbench train unet`, got some of `oysterbench train"
    ):
        list(UNet(str(checkpoint), "cpu").run([Picture("a", image(1).pixels)]))


# What a user sees


def test_without_a_training_one_line_says_how_to_make_one(home):
    with pytest.raises(
        MethodError,
        match=r"no trained weights at .*models/unet_small\.pt: "
        r"`oysterbench train unet_small --data seg-train`",
    ):
        list(find_method("unet_small").run([]))


def test_the_checkpoint_is_an_option_of_the_method(checkpoint):
    method = find_method(f"unet_small[checkpoint={checkpoint},device=cpu]")
    (predicted,) = method.run([Picture("a", image(1).pixels)])
    assert predicted.probability.shape == (48, 64)


@pytest.mark.slow
def test_the_command_trains_and_says_where_the_checkpoint_is(home, tmp_path):
    small_set(tmp_path / "set", {"one": ("train", 2), "two": ("test", 1)})
    words = ["train", "unet", "--data", str(tmp_path / "set"), "--side", "train", "--steps", "1", "--threads", "1"]
    result = CliRunner().invoke(main, [*words, "--device", "cpu"], catch_exceptions=False)
    assert result.exit_code == 0, result.stderr
    path = home / "models" / "unet.pt"
    assert result.stdout.strip() == str(path)
    assert "training unet on 2 images: 1 of 1 steps" in result.stderr
    train_side = open_labelled(tmp_path / "set").of_split("train")
    assert read_checkpoint(path).identity["data"] == {"set train": train_side.digest()}


def test_a_training_goes_on_from_another_with_smaller_steps_and_says_so(tmp_path, checkpoint):
    small_set(tmp_path / "set", {"one": ("train", 2)})
    words = [
        "train",
        "unet_small",
        "--data",
        str(tmp_path / "set"),
        "--steps",
        "1",
        "--threads",
        "1",
        "--device",
        "cpu",
    ]
    out = ["--out", str(tmp_path / "mine.pt")]
    result = CliRunner().invoke(main, [*words, *out, "--begin", str(checkpoint)], catch_exceptions=False)
    assert result.exit_code == 0, result.stderr
    first, mine = read_checkpoint(checkpoint), read_checkpoint(tmp_path / "mine.pt")
    assert mine.network == first.network, "the network is that of the training it goes on from"
    assert mine.identity["begun"]["data"] == first.identity["data"]
    moved_by = max(float((mine.weights[key] - value).abs().max()) for key, value in first.weights.items())
    assert 0 < moved_by < 1e-3
    other = CliRunner().invoke(main, ["train", "unet", *words[2:], "--begin", str(checkpoint)])
    assert other.exit_code != 0
    wrong = "expected weights of `oysterbench train unet`, got some of `oysterbench train unet_small`"
    assert wrong in " ".join(other.stderr.split())


def test_another_encoder_than_that_of_the_weights_is_refused_before_any_data_is_read(tmp_path, checkpoint):
    known = read_checkpoint(checkpoint)
    known.network["encoder"] = "lite0"
    known.write(tmp_path / "lite0.pt")
    words = ["train", "unet", "--data", str(tmp_path), "--encoder", "lite1", "--begin", str(tmp_path / "lite0.pt")]
    result = CliRunner().invoke(main, words)
    assert result.exit_code != 0
    assert "its encoder is lite0, and --encoder lite1 is asked for" in " ".join(result.stderr.split())
