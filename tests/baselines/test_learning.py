"""What trainings share: samples, augmentation, losses, and a loop that repeats and survives being killed."""

from __future__ import annotations

import dataclasses
import signal
import subprocess
import sys

import numpy as np
import pytest

from tests.helpers.paths import ROOT

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench.annotations import LabelledImage, LabelledSet  # noqa: E402
from oysterbench.core.errors import LabelError, MethodError  # noqa: E402
from oysterbench.core.streams import Streams, stream  # noqa: E402
from oysterbench.recipe import OYSTER  # noqa: E402
from oysterbench_baselines.learning.augment import Augmentation, augmented  # noqa: E402
from oysterbench_baselines.learning.batches import Mixture, make_batch  # noqa: E402
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint  # noqa: E402
from oysterbench_baselines.learning.loop import FitSettings, fit, pick_device, prepared  # noqa: E402
from oysterbench_baselines.learning.losses import bce_dice, centre_error, mask_loss, state_entropy  # noqa: E402
from oysterbench_baselines.learning.samples import LabelledDataset, depths, make_sample, offsets, states  # noqa: E402
from oysterbench_baselines.unet.network import UNetworkSettings, build_network  # noqa: E402
from oysterbench_baselines.unet.training import train  # noqa: E402
from tests.helpers.labelled_folders import image  # noqa: E402
from tests.helpers.small_trainings import SMALL, small_set  # noqa: E402

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("small") / "small", {"one": ("train", 3), "two": ("train", 3)})


def same(one, other) -> bool:
    """Whether two trainings have the same weights, to the bit."""
    return one.weights.keys() == other.weights.keys() and all(
        torch.equal(value, other.weights[key]) for key, value in one.weights.items()
    )


# Samples


def test_an_item_of_the_dataset_is_standardised_and_has_the_truth_at_the_working_scale(labelled):
    dataset = LabelledDataset(labelled, 0.5)
    pixels, truth, known = dataset[1]
    assert pixels.shape == (3, 32, 40)
    assert truth.shape == (7, 32, 40)
    assert bool((truth[6][truth[0] == 1] > 0).all())
    assert not truth[4:, truth[0] == 0].any()
    assert torch.allclose(pixels.mean(dim=(1, 2)), torch.zeros(3), atol=1e-4)
    assert torch.allclose(pixels.std(dim=(1, 2), correction=0), torch.ones(3), atol=1e-4)
    cover = float(labelled[1].oysters.mean())
    assert float(truth[0].mean()) == pytest.approx(cover, abs=0.003)
    assert bool((known == 1).all())
    assert len(list(torch.utils.data.DataLoader(dataset, batch_size=4))) == 2
    assert all(torch.equal(*pair) for pair in zip(dataset[1], (pixels, truth, known), strict=True)), "as it was read"
    with pytest.raises(IndexError):
        dataset[6]


def test_each_clip_is_drawn_as_often_whatever_its_length(tmp_path):
    dataset = LabelledDataset(small_set(tmp_path / "set", {"long": ("", 9), "short": ("", 1)}))
    rng = np.random.default_rng(0)
    drawn = [dataset.drawn(rng) for _ in range(200)]
    assert sum(one.clip == "short" for one in drawn) == pytest.approx(100, abs=25)
    assert len({one.name for one in drawn}) == 10


def test_depth_rises_from_the_border_of_each_oyster_to_its_middle_whatever_its_size():
    numbers = np.zeros((40, 60), np.uint16)
    numbers[5:25, 5:25], numbers[5:25, 25:45], numbers[30, 3] = 1, 2, 65535
    found = depths(numbers)
    assert not found[numbers == 0].any()
    for number in (1, 2, 65535):
        assert found[numbers == number].max() == 255
    assert np.array_equal(found[5:25, 5:25], found[5:25, 25:45])
    across = found[15, 5:16].astype(int)
    assert (np.diff(across[:8]) > 0).all()
    assert across[0] == round(255 * 1 / (0.8 * 10))
    assert (across[8:] == 255).all()


def test_an_oyster_that_the_image_cuts_off_has_its_border_there():
    numbers = np.ones((20, 20), np.uint16)
    found = depths(numbers)
    assert found[10, 10] == 255
    assert found[0].max() < 255 / 4


def test_of_oysters_whose_state_is_not_known_nothing_is_told():
    numbers = np.array([[0, 1, 2, 7]], np.uint16)
    live, told = states(numbers, {1: True, 2: False, 9: True})
    assert live.tolist() == [[0, 255, 0, 0]]
    assert told.tolist() == [[0, 255, 255, 0]]


def test_pixels_that_are_ignored_are_neither_in_the_loss_nor_learnt_from():
    logits = torch.randn(2, 2, 8, 8, requires_grad=True)
    truth = torch.randint(0, 2, (2, 2, 8, 8)).float()
    known = torch.ones(2, 1, 8, 8)
    known[..., :3] = 0
    loss = bce_dice(logits, truth, known)
    changed = truth.clone()
    changed[..., :3] = 1 - changed[..., :3]
    assert torch.equal(loss, bce_dice(logits, changed, known))
    loss.backward()
    assert not logits.grad[..., :3].any()
    assert logits.grad[..., 3:].all()


def test_the_loss_is_that_of_its_formula():
    logits, truth = torch.tensor([[[[2.0, -1.0]]]]), torch.tensor([[[[1.0, 0.0]]]])
    p = 1 / (1 + np.exp([-2.0, 1.0]))
    entropy = -(np.log(p[0]) + np.log(1 - p[1])) / 2
    dice = (2 * p[0] + 1) / (p.sum() + 1 + 1)
    wanted = entropy + 0.5 * (1 - dice)
    assert float(bce_dice(logits, truth, torch.ones(1, 1, 1, 2))) == pytest.approx(wanted, rel=1e-5)


def test_depth_is_learnt_as_a_share_by_cross_entropy_alone():
    """Of a plane that is 0.3 everywhere, 0.3 everywhere is the least loss, which Dice would draw towards 0 or 1."""
    truth = torch.full((1, 2, 4, 4), 0.3)
    depth = torch.zeros(1, 1, 4, 4, requires_grad=True)
    oyster = torch.zeros(1, 1, 4, 4)
    for _ in range(200):
        loss = bce_dice(torch.cat([oyster, depth], dim=1), truth, torch.ones(1, 1, 4, 4))
        (slope,) = torch.autograd.grad(loss, depth)
        depth = (depth - 50 * slope).detach().requires_grad_()
    assert torch.allclose(torch.sigmoid(depth), torch.full_like(depth, 0.3), atol=1e-3)


def test_live_is_learnt_of_what_is_told_alone():
    """Half of a pixel that is told to a half is a chance of a half; where nothing is told, nothing is learnt."""
    live, told = torch.tensor([[[[0.25, 0.0, 0.0]]]]), torch.tensor([[[[0.5, 1.0, 0.0]]]])
    logits = torch.zeros(1, 1, 1, 3, requires_grad=True)
    state_entropy(logits, live, told).backward()
    assert logits.grad.flatten().tolist() == pytest.approx([0, 0.5 / 1.5, 0])
    assert float(state_entropy(logits.detach(), live, torch.zeros_like(told))) == 0


def test_a_network_without_the_plane_of_states_learns_from_the_others():
    truth, known = torch.rand(1, 7, 8, 8), torch.ones(1, 1, 8, 8)
    two, three = torch.randn(1, 2, 8, 8), torch.zeros(1, 1, 8, 8)
    pixels = torch.zeros(1, 3, 8, 8)
    alone = mask_loss(lambda _: two, pixels, truth, known)
    assert torch.equal(alone, bce_dice(two, truth[:, :2], known))
    assert float(mask_loss(lambda _: torch.cat([two, three], dim=1), pixels, truth, known)) > float(alone)


def numbered(numbers):
    """A sample of nothing but oysters."""
    empty = np.zeros(numbers.shape, np.uint8)
    classes = np.where(numbers > 0, OYSTER, 0).astype(np.uint8)
    return make_sample(LabelledImage("a", "", np.stack([empty] * 3, axis=-1), classes, numbers, empty > 0), 1.0)


def test_a_pixel_learns_where_the_centre_of_its_oyster_is_and_large_oysters_do_not_drown_small_ones():
    numbers = np.zeros((40, 60), np.uint16)
    numbers[10:15, 10:15], numbers[10:35, 30:55] = 1, 2
    sample = numbered(numbers)
    assert sample.centres == pytest.approx(np.array([[0, 0, 0], [12, 12, 2.82], [42, 22, 14.1]]), abs=0.01)
    towards = offsets(sample.numbers, sample.centres)
    assert towards[10, 14] == pytest.approx([-2, 2, 2.82], abs=0.01)
    assert not towards[numbers == 0].any()

    truth = torch.from_numpy(towards.transpose(2, 0, 1))[None]
    known = torch.ones(1, 1, 40, 60)
    right = torch.cat([truth[:, :2] / 16, torch.log(truth[:, 2:].clamp(min=1) / 8)], dim=1)
    assert float(centre_error(right, truth, known)) == pytest.approx(0, abs=1e-6)
    off = [right + 1.0 * torch.from_numpy(numbers == k) for k in (1, 2)]
    small, large = (float(centre_error(planes, truth, known)) for planes in off)
    assert large / 5 < small < large  # of a 25th of the area, and of as many px off that count five times
    assert float(centre_error(off[0], truth, known * (truth[:, 2:] > 5))) == 0, "what is not known is not learnt"
    assert float(centre_error(right, torch.zeros_like(truth), known)) == 0


@pytest.mark.parametrize("encoder", ["", "lite0"])
def test_centres_are_learnt_in_training_and_nothing_is_said_of_them_later(encoder):
    settings = UNetworkSettings(depth=2, base=4, groups=2, encoder=encoder, centres=True)
    network = build_network(settings)
    pixels = torch.randn(1, 3, 32, 32)
    learnt = network.train()(pixels)
    assert network.eval()(pixels).shape == (1, 2, 32, 32)
    centre = torch.ones(1, 7, 32, 32)
    centre[:, 2:4] = 0  # nothing is told of its state
    mask_loss(lambda _: learnt, pixels, centre, torch.ones(1, 1, 32, 32)).backward()
    told = network.head.weight.grad.abs().sum(dim=(1, 2, 3)) > 0
    assert told.tolist() == [True, True, False, True, True, True]


# Augmentation


def test_pictures_and_truth_are_moved_alike():
    """A picture that is its own mask stays so, whatever is done to both."""
    one = image(3, height=64, width=80)
    drawn = np.repeat(np.where(one.oysters, 220, 20).astype(np.uint8)[..., None], 3, axis=2)
    sample = make_sample(dataclasses.replace(one, pixels=drawn), 1.0)
    still = Augmentation(crop=32, gain=0, shift=0, tint=0, noise=0, grey=0, blur=0)
    for k in range(20):
        values, truth, known = augmented(sample, still, stream(k, b"", "test"))
        assert values.shape == (32, 32, 3)
        assert np.array_equal(known, np.full((32, 32), 255))
        shown = (values[..., 0] * sample.contrast[0] + sample.mean[0] - 20) / 200
        assert np.abs(shown - truth[..., 0]).max() < 0.05


def test_the_centre_of_an_oyster_is_where_its_crop_has_it_however_it_lies():
    y, x = np.mgrid[:64, :80]
    sample = numbered(((x - 40) ** 2 + (y - 30) ** 2 <= 36).astype(np.uint16) * 7)
    still = Augmentation(crop=64, gain=0, shift=0, tint=0, noise=0, grey=0, blur=0)
    seen = 0
    for k in range(20):
        _, truth, _ = augmented(sample, still, stream(k, b"", "test"))
        rows, columns = np.nonzero(truth[..., 6])
        if len(rows) and min(rows.min(), columns.min()) > 1 and max(rows.max(), columns.max()) < 62:
            seen += 1
            places = truth[rows, columns, 4:6] + np.column_stack([columns, rows])
            assert np.ptp(places, axis=0).max() < 1e-3
            assert places[0] == pytest.approx([columns.mean(), rows.mean()], abs=0.5)
            assert truth[rows[0], columns[0], 6] == pytest.approx(np.sqrt(len(rows) / np.pi), rel=0.05)
    assert seen > 5


def test_batches_depend_on_seed_and_step_alone(labelled):
    mixture = Mixture([LabelledDataset(labelled, 0.5)], [4])
    one = make_batch(mixture, SMALL.augmentation, Streams(7), 5)
    make_batch(mixture, SMALL.augmentation, Streams(7), 4)
    again = make_batch(mixture, SMALL.augmentation, Streams(7), 5)
    assert all(torch.equal(a, b) for a, b in zip(one, again, strict=True))
    for other in (make_batch(mixture, SMALL.augmentation, Streams(s), k) for s, k in ((7, 6), (8, 5))):
        assert not torch.equal(one[0], other[0])


# The loop


def test_training_twice_with_a_seed_gives_the_same_weights_and_another_seed_others(labelled, tmp_path):
    one, again = (train(labelled, tmp_path / f"{k}.pt", SMALL, 3, CPU) for k in range(2))
    other = train(labelled, tmp_path / "other.pt", SMALL, 4, CPU)
    assert same(one, again)
    assert one.losses == again.losses
    assert not same(one, other)


def test_a_finished_training_is_read_and_not_done_again(labelled, tmp_path):
    one = train(labelled, tmp_path / "a.pt", SMALL, 3, CPU)
    steps = []
    again = train(labelled, tmp_path / "a.pt", SMALL, 3, CPU, lambda done, total: steps.append(done))
    assert steps == []
    assert same(one, again)


def test_a_checkpoint_says_all_that_is_needed_to_repeat_it(labelled, tmp_path):
    train(labelled, tmp_path / "a.pt", SMALL, 3, CPU)
    known = read_checkpoint(tmp_path / "a.pt")
    assert known.finished
    assert known.identity["seed"] == 3
    assert known.identity["data"] == {"small": labelled.digest()}
    assert known.identity["settings"]["fit"]["threads"] == 1
    assert known.network == {"kind": "unet", **dataclasses.asdict(SMALL.network)}
    assert set(known.versions) == {"oysterbench", "torch", "numpy", "python"}
    assert (known.optimiser, known.random) == ({}, {}), "which only a training that is resumed needs"
    assert len(known.losses) == known.step == 12


def test_a_training_of_other_data_or_settings_is_not_gone_on_with(labelled, tmp_path):
    train(labelled, tmp_path / "a.pt", SMALL, 3, CPU)
    more = dataclasses.replace(SMALL, fit=dataclasses.replace(SMALL.fit, steps=13))
    with pytest.raises(MethodError, match=r"a\.pt: holds a training with steps = 12, and this one has steps = 13"):
        train(labelled, tmp_path / "a.pt", more, 3, CPU)
    with pytest.raises(MethodError, match=r"a training with small = .*: the images or labels of small have changed"):
        train(labelled.where(lambda entry: entry.clip == "one"), tmp_path / "a.pt", SMALL, 3, CPU)


def test_no_images_and_a_loss_that_is_no_number_are_named(labelled, tmp_path):
    with pytest.raises(LabelError, match="expected images to train on, got none"):
        train(LabelledSet("empty", []), tmp_path / "a.pt", SMALL, 3, CPU)
    wild = dataclasses.replace(SMALL, fit=FitSettings(steps=30, warm_up=1, learning_rate=1e30, threads=1))
    with pytest.raises(MethodError, match=r"the loss is (nan|inf) after"):
        train(labelled, tmp_path / "a.pt", wild, 3, CPU)


def test_a_damaged_checkpoint_is_named(tmp_path):
    (tmp_path / "a.pt").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(MethodError, match=r"a\.pt: not a checkpoint of this version"):
        read_checkpoint(tmp_path / "a.pt")
    with pytest.raises(MethodError, match="no such checkpoint; `oysterbench train` makes one"):
        read_checkpoint(tmp_path / "b.pt")


def test_a_checkpoint_of_which_bytes_were_lost_or_changed_is_named(tmp_path):
    whole = tmp_path / "a.pt"
    Checkpoint({}, {}, {"w": torch.ones(4000)}, {}, {}, 0, False, [], 0.0).write(whole)
    assert read_checkpoint(whole).weights["w"].sum() == 4000
    data = whole.read_bytes()
    whole.write_bytes(data[: len(data) // 2])
    with pytest.raises(MethodError, match=r"a\.pt: not a checkpoint .* cut short .*; get the file again, delete"):
        read_checkpoint(whole)
    at = data.find(torch.ones(4).numpy().tobytes())
    whole.write_bytes(data[:at] + bytes(400) + data[at + 400 :])
    with pytest.raises(MethodError, match=r"a\.pt: damaged: \S+ does not match its checksum; get the file again"):
        read_checkpoint(whole)


def test_a_device_that_is_not_there_is_named():
    for name in ("abacus", "mps", "meta"):
        with pytest.raises(MethodError, match=f"device '{name}': expected auto, cpu, cuda"):
            pick_device(name)
    if not torch.cuda.is_available():
        with pytest.raises(MethodError, match="sees no GPU; expected auto or cpu"):
            pick_device("cuda")


KILLED = """
import sys
from pathlib import Path
sys.path[:0] = sys.argv[3:]
from tests.helpers.small_trainings import SMALL
import torch
from oysterbench.annotations import open_labelled
from oysterbench_baselines.learning import loop
from oysterbench_baselines.unet.training import train
loop.KEEP_S = 0.0
train(open_labelled(sys.argv[1]), Path(sys.argv[2]), SMALL, 3, torch.device("cpu"),
      lambda done, total: print(done, flush=True))
"""


@pytest.mark.slow
def test_a_training_that_is_killed_goes_on_to_the_same_weights(labelled, tmp_path):
    wanted = train(labelled, tmp_path / "whole.pt", SMALL, 3, CPU)
    path = tmp_path / "killed.pt"
    folder = labelled.entries[0].files[0].parents[1]
    words = [sys.executable, "-c", KILLED, folder, path, ROOT]
    process = subprocess.Popen([*map(str, words)], stdout=subprocess.PIPE, text=True)
    for line in process.stdout:
        if int(line) == 7:
            process.send_signal(signal.SIGKILL)
            break
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL
    left = read_checkpoint(path)
    assert not left.finished
    assert 6 <= left.step < 12
    steps = []
    found = train(labelled, path, SMALL, 3, CPU, lambda done, total: steps.append(done))
    assert steps == list(range(left.step + 1, 13))
    assert same(found, wanted)
    assert found.losses == wanted.losses


@pytest.mark.parametrize("start", [0.5, 1.0])
def test_final_weights_go_back_towards_those_that_a_training_began_with(tmp_path, monkeypatch, start):
    """Whether or not it was interrupted before its last step: what it goes back to is made anew."""

    def trained(share, name, steps_at_once=8):
        path = tmp_path / name
        settings = FitSettings(steps=8, learning_rate=0.1, warm_up=1, threads=1, start=share)

        def batch(step):
            if step == steps_at_once:
                raise KeyboardInterrupt
            return (torch.full((4, 3), 1.0 + step),)

        arguments = (lambda: torch.nn.Linear(3, 1), {}, batch, lambda network, x: network(x).square().mean(), settings)
        return fit(*arguments, {}, path, torch.device("cpu"), 5).weights

    torch.manual_seed(5)
    begun = torch.nn.Linear(3, 1).weight.detach()
    last, found = trained(0.0, "last")["weight"], trained(start, "found")["weight"]
    assert not torch.allclose(last, begun, atol=0.01)
    torch.testing.assert_close(found, start * begun + (1 - start) * last)
    monkeypatch.setattr("oysterbench_baselines.learning.loop.KEEP_S", 0.0)
    with pytest.raises(KeyboardInterrupt):
        trained(start, "resumed", steps_at_once=5)
    assert torch.equal(trained(start, "resumed")["weight"], found)


def test_batches_that_are_prepared_ahead_are_the_same_in_the_same_order(labelled):
    mixture = Mixture([LabelledDataset(labelled, 0.5).load()], [2])

    def batch(step):
        return make_batch(mixture, Augmentation(crop=32), Streams(3), step)

    for step, found in zip(range(4, 10), prepared(batch, range(4, 10), workers=3), strict=True):
        for one, other in zip(found, batch(step), strict=True):
            assert torch.equal(one, other)
