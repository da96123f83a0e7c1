"""The network that steers: what it learns, that it repeats, and what a user sees where it cannot be used."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench.core.errors import LabelError, MethodError  # noqa: E402
from oysterbench.core.places import released_models  # noqa: E402
from oysterbench.core.streams import Streams, stream  # noqa: E402
from oysterbench.methods import find_method  # noqa: E402
from oysterbench.methods.adapters import PythonMethod  # noqa: E402
from oysterbench.methods.steering import VehicleState, View  # noqa: E402
from oysterbench.recipe import SteeringRecipe  # noqa: E402
from oysterbench_baselines import steering  # noqa: E402
from oysterbench_baselines.learning import loop  # noqa: E402
from oysterbench_baselines.learning.augment import Augmentation  # noqa: E402
from oysterbench_baselines.learning.card import describe  # noqa: E402
from oysterbench_baselines.learning.checkpoint import read_checkpoint  # noqa: E402
from oysterbench_baselines.learning.loop import FitSettings  # noqa: E402
from oysterbench_baselines.steering import SteeringNet  # noqa: E402
from oysterbench_baselines.steering.augment import SteeringAugmentation, augmented, mirrored  # noqa: E402
from oysterbench_baselines.steering.command import command  # noqa: E402
from oysterbench_baselines.steering.examples import TrainingExamples, action_values_of, joined, senses_of, small  # noqa: E402
from oysterbench_baselines.steering.memory import SHAPE, Memory  # noqa: E402
from oysterbench_baselines.steering.model import SteeringModel, as_planes  # noqa: E402
from oysterbench_baselines.steering.network import SteeringNetwork, SteeringNetworkSettings  # noqa: E402
from oysterbench_baselines.steering.scoring import score  # noqa: E402
from oysterbench_baselines.steering.training import SteeringSettings, cost, losses_of, make_batch, train  # noqa: E402
from tests.helpers.weights_made import card_of  # noqa: E402

TASK = SteeringRecipe(
    yaw_deg=(30.0, 20.0, 10.0, 0.0, -10.0, -20.0, -30.0),
    pitch_deg=(-24.0, -16.0, -8.0, 0.0, 8.0, 16.0, 24.0),
    altitude_m=(0.5, 1.4),
)
NETWORK = SteeringNetworkSettings(width=32, height=24, channels=(8, 16), columns=8, hidden=32, dropout=0.0)
STILL = SteeringAugmentation(
    flip=0.0, move=0.0, haze=0.0, senses=0.0, colours=Augmentation(gain=0, shift=0, tint=0, noise=0, grey=0, blur=0)
)
SMALL = SteeringSettings(batch=8, network=NETWORK, fit=FitSettings(steps=12, warm_up=2, threads=1))


def toy(count: int, first: int = 0) -> TrainingExamples:
    """A light patch on dark ground: best is the turn of yaw towards it, and the turn of pitch that the altitude asks
    for; each class away from these loses 2 oysters."""
    pixels, senses, looked, action_values = [], [], [], []
    for k in range(first, first + count):
        rng = stream(k, b"", "toy")
        yaw, altitude = int(rng.integers(7)), float(rng.uniform(0.2, 1.7))
        picture = rng.integers(20, 60, (48, 64, 3)).astype(np.uint8)
        column = 2 + 9 * yaw
        picture[20:36, column - 2 : column + 6] = (200, 190, 150)
        pitch = int(np.clip(round(3 + 4 * (altitude - 0.95)), 0, 6))
        pixels.append(small(picture, NETWORK))
        senses.append(senses_of(VehicleState(0.3, 0.0, 3.0, altitude), TASK))
        looked.append(rng.integers(0, 2, SHAPE).astype(np.uint8))
        y, p = np.ogrid[:7, :7]
        action_values.append(10.0 - 2 * np.abs(y - yaw) - 2 * np.abs(p - pitch))
    return TrainingExamples(
        TASK,
        np.stack(pixels),
        np.stack(senses),
        np.stack(looked),
        np.stack(action_values).astype(np.float32),
        np.zeros(count, bool),
    )


def same(one, other) -> bool:
    """Whether two trainings have the same weights, to the bit."""
    return one.weights.keys() == other.weights.keys() and all(
        torch.equal(value, other.weights[key]) for key, value in one.weights.items()
    )


def taught(path, steps):
    """The weights of a network that has been shown the toy for so many steps."""
    augmentation = dataclasses.replace(SteeringAugmentation(), move=1.0)
    fit = FitSettings(steps=steps, learning_rate=5e-3, warm_up=10, threads=1)
    train(toy(200), path, dataclasses.replace(SMALL, batch=16, fit=fit, augmentation=augmentation), 0)
    return path


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """A network that has begun to learn."""
    return taught(tmp_path_factory.mktemp("steering") / "toy.pt", 100)


# What it learns


@pytest.mark.slow
def test_it_turns_to_what_it_was_shown_and_keeps_its_altitude(tmp_path):
    found = score(SteeringModel.read(taught(tmp_path / "toy.pt", 300)), toy(60, first=1000))
    assert found.yaw > 0.9
    assert found.pitch > 0.9
    assert found.skill > 0.8


def test_no_side_is_preferred_a_picture_and_its_mirror_image_are_answered_alike(checkpoint):
    model, examples = SteeringModel.read(checkpoint), toy(8, first=2000)
    there = dataclasses.replace(examples, pixels=examples.pixels[:, :, ::-1], looked=examples.looked[:, :, ::-1])
    yaw, pitch = model.predictions(examples)
    other_yaw, other_pitch = model.predictions(there)
    assert np.allclose(other_yaw[:, ::-1], yaw, atol=1e-6)
    assert np.allclose(other_pitch, pitch, atol=1e-6)
    assert np.allclose(yaw.sum(axis=1), 1, atol=1e-5)


class Dive:
    """Views as an evaluator gives them."""

    def __init__(self, views, task=TASK):
        self.task, self.views = task, views

    def __iter__(self):
        return iter(self.views)


def test_the_method_answers_view_by_view_as_the_network_does(checkpoint):
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[20:36, 50:60] = 200  # to the right
    views = [
        View("a", picture, VehicleState(0, 0, 3, 1.5), 0.0),
        View("b", picture[:, ::-1].copy(), VehicleState(1, 0, 2, 0.4), 1.0),
    ]
    given = []

    def watched():
        for view in views:
            given.append(view.name)
            yield view

    answers = SteeringNet(str(checkpoint)).run(Dive(watched()))
    first = next(answers)
    assert given == ["a"]
    assert first.name == "a"
    assert first.yaw_probability.argmax() > 3
    assert first.pitch_probability.argmax() > 3
    (second,) = answers
    assert second.yaw_probability.argmax() < 3
    assert second.pitch_probability.argmax() < 3


def test_the_network_has_a_row_of_logits_for_each_axis_and_as_many_weights_as_its_page_says():
    page = (Path(steering.__file__).parent / "README.md").read_text()
    weights = sum(p.numel() for p in SteeringNetwork(SteeringNetworkSettings(), 7, 7).parameters())
    assert f"{weights:_}".replace("_", " ") in page
    network = SteeringNetwork(SteeringNetworkSettings(), 7, 5)
    yaw, pitch = network(torch.zeros(2, 3, 72, 96), torch.zeros(2, 2), torch.zeros(2, 1, *SHAPE))
    assert yaw.shape == (2, 7)
    assert pitch.shape == (2, 5)


# Its memory


def level(heading_deg: float, altitude: float = 1.0) -> VehicleState:
    return VehicleState(float(np.radians(heading_deg)), 0.0, 3.0, altitude)


def test_what_is_before_the_vehicle_has_been_looked_at_and_what_lies_behind_has_not():
    looked = Memory(TASK).observe(level(77.0), 5.0)
    ahead, behind = looked[:8], looked[8:]
    assert ahead[-2, 5:7].all()  # 1.1 m straight on
    assert not ahead[:5].any()  # from 2.25 m on
    assert not behind.any()
    assert np.array_equal(looked, looked[:, ::-1])


def test_the_map_turns_and_moves_with_the_vehicle():
    """After a way straight on, what was ahead lies behind; after a turn to the left, it lies to the right."""
    memory = Memory(TASK)
    first = memory.observe(level(20.0), 4.0)
    moved = memory.observe(level(20.0, altitude=5.0), 7.0)  # 1.5 m, two cells; so high that nothing is near
    assert np.array_equal(moved[2:], first[:-2])
    memory = Memory(TASK)
    memory.observe(level(20.0), 0.0)
    turned = memory.observe(level(110.0, altitude=5.0), 0.0)
    assert turned[:, 6:].any()
    assert not turned[:, :6].any()


# The loss


def test_commands_that_are_as_good_are_as_right_and_a_miss_costs_what_it_loses():
    logits = torch.tensor([[5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 5.0]])
    lost = torch.tensor([[0.0, 0.0, 3.0]]).repeat(3, 1)
    settings = SteeringSettings(temperature=0.2)
    left, middle, right = (float(cost(logits[k : k + 1], lost[k : k + 1], settings)) for k in range(3))
    assert left == pytest.approx(middle)
    assert right > left + 2


def test_the_cost_is_that_of_its_formula():
    logits, lost = torch.tensor([[1.0, 0.0, -1.0]]), torch.tensor([[4.0, 0.0, 2.0]])
    target = np.exp([-2.0, 0.0, -1.0]) / np.exp([-2.0, 0.0, -1.0]).sum()
    predicted = np.exp([1.0, 0.0, -1.0]) / np.exp([1.0, 0.0, -1.0]).sum()
    wanted = -(target * np.log(predicted)).sum()
    assert float(cost(logits, lost, SteeringSettings(temperature=2.0))) == pytest.approx(wanted, rel=1e-5)


def test_a_turn_loses_what_the_best_command_with_it_loses_in_medians_of_its_axis():
    action_values = np.array([[[28.0, 24.0, 0.0], [20.0, 26.0, 0.0], [22.0, 22.0, 0.0]]], np.float32)
    yaw, pitch = losses_of(action_values)
    assert yaw == pytest.approx(np.array([[0, 1, 3]]))  # 0, 2, 6 oysters
    assert pitch == pytest.approx(np.array([[0, 1, 14]]))  # 0, 2, 28
    assert losses_of(100 * action_values)[0] == pytest.approx(yaw)
    assert not losses_of(np.zeros((1, 3, 2), np.float32))[0].any()


# Augmentation


def test_a_mirrored_picture_has_its_commands_mirrored_and_twice_is_as_it_was():
    known, _, map_known, values_known = toy(1)[0]
    pixels, looked, action_values = mirrored(known, map_known, values_known)
    assert np.array_equal(pixels, known[:, ::-1])
    yaw, pitch = np.unravel_index(values_known.argmax(), (7, 7))
    assert np.unravel_index(action_values.argmax(), (7, 7)) == (6 - yaw, pitch)
    for again, first in zip(mirrored(pixels, looked, action_values), (known, map_known, values_known), strict=True):
        assert np.array_equal(again, first)


def test_what_is_not_changed_is_what_the_method_would_see():
    known = toy(1)[0]
    pixels, *others = augmented(*known, STILL, stream(0, b"", "still"))
    assert np.abs(pixels.transpose(2, 0, 1) - as_planes(known[0])).max() < 0.05
    for one, other in zip(others, known[1:], strict=True):
        assert np.array_equal(one, other)


def test_classes_that_are_not_symmetric_are_never_mirrored():
    lopsided = dataclasses.replace(TASK, yaw_deg=(30.0, 20.0, 10.0, 0.0, -10.0, -20.0, -40.0))
    examples = dataclasses.replace(toy(5), task=lopsided)
    always = dataclasses.replace(STILL, flip=1.0)
    for task, mirror in ((TASK, True), (lopsided, False)):
        settings = dataclasses.replace(SMALL, augmentation=always)
        *_, yaw, _ = make_batch(dataclasses.replace(examples, task=task), settings, Streams(0), 0)
        known, _ = losses_of(examples.action_values)
        known = known[:, ::-1] if mirror else known
        assert all(any(np.allclose(row, one) for one in known) for row in yaw.numpy())


def test_dives_are_as_much_of_a_batch_as_is_asked_for_however_few_there_are():
    one = toy(40)
    few = dataclasses.replace(one, from_rollout=np.arange(40) < 2)
    settings = dataclasses.replace(SMALL, batch=64, augmentation=STILL)

    def from_rollout(examples, share):
        _, told, *_ = make_batch(examples, dataclasses.replace(settings, from_rollout=share), Streams(0), 0)
        return np.isin(told[:, 0].numpy(), one.senses[:2, 0]).mean()

    assert from_rollout(few, 1.0) == 1
    assert 0.35 < from_rollout(few, 0.5) < 0.65
    assert from_rollout(few, 0.0) == 0
    assert 0 < from_rollout(one, 1.0) < 0.2  # where there are none, of what there is


# It repeats


def test_training_twice_with_a_seed_gives_the_same_weights_and_another_seed_others(tmp_path):
    examples = toy(20)
    one, again = (train(examples, tmp_path / f"{k}.pt", SMALL, 3) for k in range(2))
    other = train(examples, tmp_path / "other.pt", SMALL, 4)
    assert same(one, again)
    assert one.losses == again.losses
    assert not same(one, other)


def test_a_training_that_is_stopped_goes_on_to_the_same_weights(tmp_path, monkeypatch):
    examples = toy(20)
    settings = dataclasses.replace(SMALL, network=dataclasses.replace(NETWORK, dropout=0.5))
    wanted = train(examples, tmp_path / "whole.pt", settings, 3)
    monkeypatch.setattr(loop, "KEEP_S", 0.0)

    def stop(done, total):
        if done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(examples, tmp_path / "stopped.pt", settings, 3, stop)
    assert read_checkpoint(tmp_path / "stopped.pt").step == 6
    found = train(examples, tmp_path / "stopped.pt", settings, 3)
    assert same(found, wanted)
    assert found.losses == wanted.losses


def test_a_training_on_other_lessons_is_not_gone_on_with(tmp_path):
    train(toy(20), tmp_path / "a.pt", SMALL, 3)
    with pytest.raises(MethodError, match="holds a training with examples = "):
        train(toy(20, first=7), tmp_path / "a.pt", SMALL, 3)


# What a user sees


def test_without_weights_one_line_says_how_to_make_some(tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_STEERING", str(tmp_path / "models" / "steering.pt"))
    with pytest.raises(MethodError, match=r"no trained weights at .*models/steering\.pt: `oysterbench train steering "):
        list(SteeringNet().run(Dive([])))


def test_the_checkpoint_is_an_option_of_the_method_that_is_found_by_its_name(checkpoint):
    method = find_method(f"steering[checkpoint={checkpoint}]")
    assert method.track == "steering"
    (predicted,) = method.run(Dive([View("a", np.zeros((24, 32, 3), np.uint8), VehicleState(0, 0, 3, 1), 0.0)]))
    assert predicted.yaw_probability.shape == (7,)


def test_a_release_says_what_a_checkpoint_has_learnt(checkpoint):
    described = describe("steering", checkpoint)
    assert described.data == read_checkpoint(checkpoint).identity["data"]
    assert json.loads(card_of(checkpoint, "steering", described).data)["training"]["data"] == described.data


def test_two_trainings_are_told_apart_in_results(checkpoint, tmp_path, home, monkeypatch):
    train(toy(4), tmp_path / "a.pt", SMALL, 0)
    paths = (checkpoint, tmp_path / "a.pt")
    one, other = (PythonMethod(f"steering[checkpoint={path}]", ["steering"]).settings for path in paths)
    assert one == {"weights": {"steering": hashlib.sha256(checkpoint.read_bytes()).hexdigest()}}  # and not where it is
    assert one != other
    released = hashlib.sha256((released_models() / "steering.pt").read_bytes()).hexdigest()
    assert PythonMethod("steering", ["steering"]).settings == {"weights": {"steering": released}}
    monkeypatch.setenv("OYSTERBENCH_STEERING", str(tmp_path / "none.pt"))
    assert PythonMethod("steering", ["steering"]).settings == {"weights": {"steering": ""}}


def test_a_task_with_other_classes_is_refused(checkpoint):
    fewer = dataclasses.replace(TASK, yaw_deg=(20.0, 0.0, -20.0))
    with pytest.raises(MethodError, match=r"expected the 7 classes of yaw 30, .* got 3: 20, 0, -20 deg"):
        list(SteeringNet(str(checkpoint)).run(Dive([], fewer)))
    with pytest.raises(MethodError, match="the data: expected the 7 classes of yaw"):
        joined([toy(2), dataclasses.replace(toy(2), task=fewer)])


def test_labels_of_other_classes_and_no_views_are_refused(tmp_path):
    import pandas as pd

    with pytest.raises(LabelError, match="expected a value for each of 7 x 7 commands, got 2 of them"):
        action_values_of(pd.DataFrame({"value_0_0": [1.0], "value_0_1": [2.0]}), TASK, "a.mcap")
    one = toy(1)
    empty = TrainingExamples(
        TASK, one.pixels[:0], one.senses[:0], one.looked[:0], one.action_values[:0], one.from_rollout[:0]
    )
    with pytest.raises(LabelError, match="expected views to train on, got none"):
        train(empty, tmp_path / "a.pt", SMALL, 0)


def test_a_checkpoint_of_another_method_is_refused(tmp_path):
    known = train(toy(4), tmp_path / "a.pt", SMALL, 0)
    known.network["kind"] = "unet"
    known.write(tmp_path / "unet.pt")
    with pytest.raises(MethodError, match="expected the checkpoint of `oysterbench train steering`, got one of 'unet'"):
        list(SteeringNet(str(tmp_path / "unet.pt")).run(Dive([])))


def test_the_old_name_of_an_option_says_the_new_one():
    done = CliRunner().invoke(command, ["--data", "steer-mini", "--dive-s", "60"])
    assert done.exit_code == 2
    assert "--dive-s is named --rollout-s now" in done.output
