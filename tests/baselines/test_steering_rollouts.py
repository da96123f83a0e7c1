"""Training examples from sequence files and from dives: what DAgger collects, and that it goes on where it was
stopped."""

from __future__ import annotations

import dataclasses
import io
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

import oysterbench  # noqa: E402
from oysterbench.core.errors import LabelError, MethodError, SequenceError  # noqa: E402
from oysterbench.methods.steering import VehicleState  # noqa: E402
from oysterbench.simulation.generate import generate_split  # noqa: E402
from oysterbench_baselines.learning.card import all_data_of, origin_of  # noqa: E402
from oysterbench_baselines.learning.checkpoint import read_checkpoint  # noqa: E402
from oysterbench_baselines.learning.loop import FitSettings  # noqa: E402
from oysterbench_baselines.steering import dagger  # noqa: E402
from oysterbench_baselines.steering.dagger import Reef, Rounds, collect, learn_rounds, reef_of  # noqa: E402
from oysterbench_baselines.steering.examples import files_of, joined, read_all, read_examples, senses_of, small  # noqa: E402
from oysterbench_baselines.steering.memory import Memory  # noqa: E402
from oysterbench_baselines.steering.network import SteeringNetworkSettings  # noqa: E402
from oysterbench_baselines.steering.training import SteeringSettings, train  # noqa: E402
from tests.helpers.exploring_made import made_split  # noqa: E402

NETWORK = SteeringNetworkSettings(width=32, height=24, channels=(8, 16), columns=8, hidden=32)
SETTINGS = SteeringSettings(batch=4, network=NETWORK, fit=FitSettings(steps=4, warm_up=1, threads=1))
PLAN = Rounds(rounds=2, seconds=3.0, steps=3)
ONE = dataclasses.replace(PLAN, rounds=1)
SPLIT = made_split()
REEFS = [Reef(SPLIT, "one"), Reef(SPLIT, "two")]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two very small reefs, rendered and labelled."""
    return list(generate_split(SPLIT, tmp_path_factory.mktemp("made")).values())


@pytest.fixture(scope="module")
def examples(files):
    return read_all(files, NETWORK)


def equal(one, other) -> bool:
    return one.digest() == other.digest()


# From files


def test_lessons_are_the_pictures_of_a_file_with_the_labels_of_their_moment(files):
    sequence = oysterbench.open(files[0])
    table, found = sequence.steering(), read_examples(files[0], NETWORK)
    images = list(sequence.images("cam_front"))
    assert len(found) == len(table) == len(images) == 10
    assert found.task == SPLIT.steering
    memory = Memory(SPLIT.steering)
    for k, row in enumerate(table.itertuples()):
        assert images[k].stamp_ns == row.stamp_ns
        state = VehicleState(row.heading_rad, row.pitch_rad, row.depth_m, row.altitude_m)
        pixels, senses, looked, action_values = found[k]
        assert np.array_equal(pixels, small(images[k].pixels, NETWORK))
        assert np.array_equal(senses, senses_of(state, SPLIT.steering))
        assert np.array_equal(looked, memory.observe(state, 2.0 * k))
        assert action_values[row.yaw, row.pitch] == action_values.max()
        assert action_values[2, 5] == np.float32(row.value_2_5)


def test_several_files_are_one_after_the_other_and_a_folder_is_its_files(files, examples):
    assert equal(examples, joined([read_examples(path, NETWORK) for path in files]))
    assert files_of(str(files[0].parent)) == files
    assert files_of(str(files[0])) == files[:1]
    assert reef_of(files[1]) == REEFS[1]


def test_data_of_another_kind_is_named(tiny_file, tmp_path):
    with pytest.raises(LabelError, match=r"expected a split, a sequence .* or a folder of them"):
        files_of(str(tmp_path / "nothing"))
    with pytest.raises(LabelError, match="slam-mini: expected a split of the track steering, got one of slam"):
        files_of("slam-mini")
    with pytest.raises(SequenceError, match="has no ground truth about steering"):
        read_examples(tiny_file, NETWORK)


# From dives


@pytest.fixture(scope="module")
def policy(examples, tmp_path_factory):
    """The folder of a training before any dive."""
    folder = tmp_path_factory.mktemp("policy")
    train(examples, folder / "round-0.pt", SETTINGS, 0)
    return folder


@pytest.fixture(scope="module")
def dives(policy):
    """The examples of a first round, one dive after the other."""
    return collect(REEFS, read_checkpoint(policy / "round-0.pt"), policy, NETWORK, PLAN, 1)


def test_each_view_of_a_dive_is_a_lesson(dives):
    assert [len(one) for one in dives] == [3, 3]
    for one in dives:
        assert one.pixels.shape == (3, 24, 32, 3)
        assert one.action_values.shape == (3, 7, 7)
        assert np.isfinite(one.action_values).all()
        assert one.looked.reshape(3, -1).any(axis=1).all()
    assert not equal(*dives)


@pytest.mark.slow
def test_dives_in_two_processes_are_those_in_one(policy, dives, tmp_path):
    (tmp_path / "round-0.pt").write_bytes((policy / "round-0.pt").read_bytes())
    again = collect(REEFS, read_checkpoint(policy / "round-0.pt"), tmp_path, NETWORK, PLAN, 1, workers=2)
    assert all(equal(one, other) for one, other in zip(dives, again, strict=True))


@pytest.mark.slow
def test_finished_dives_are_read_and_those_of_another_policy_are_done_again(policy, dives, examples, monkeypatch):
    done = []
    original = dagger.rollout

    def counted(reef, **options):
        done.append(reef.name)
        return original(reef, **options)

    monkeypatch.setattr(dagger, "rollout", counted)
    known = read_checkpoint(policy / "round-0.pt")
    again = collect(REEFS, known, policy, NETWORK, PLAN, 1)
    assert done == []
    assert all(equal(one, other) for one, other in zip(dives, again, strict=True))
    (policy / "round-1" / "two.npz").unlink()
    collect(REEFS, known, policy, NETWORK, PLAN, 1)
    assert done == ["two"]
    collect(REEFS, known, policy, NETWORK, dataclasses.replace(PLAN, beta=0.9), 1)
    assert done == ["two", "one", "two"]


@pytest.mark.slow
def test_rounds_that_are_stopped_go_on_to_the_same_weights(examples, tmp_path, monkeypatch):
    wanted = learn_rounds(examples, REEFS, tmp_path / "whole.pt", SETTINGS, PLAN, 0)
    assert read_checkpoint(tmp_path / "whole.pt").losses == wanted.losses
    written = (tmp_path / "whole.pt").stat().st_ino
    learn_rounds(examples, REEFS, tmp_path / "whole.pt", SETTINGS, PLAN, 0)
    assert (tmp_path / "whole.pt").stat().st_ino == written, "results name it by its bytes"
    assert list(all_data_of(wanted.identity)) == [SPLIT.name, "rollouts of round 1", "rollouts of round 2"]
    begun = origin_of(wanted.identity, "")
    assert begun is not None
    assert begun.what == (
        f"weights of steering after {PLAN.steps} steps on {SPLIT.name}, rollouts of round 1, begun from weights of "
        f"steering after {SETTINGS.fit.steps} steps on {SPLIT.name}"
    )
    original, done = dagger.rollout, []

    def stopped(reef, **options):
        done.append(reef.name)
        if len(done) == 4:
            raise KeyboardInterrupt
        return original(reef, **options)

    monkeypatch.setattr(dagger, "rollout", stopped)
    with pytest.raises(KeyboardInterrupt):
        learn_rounds(examples, REEFS, tmp_path / "stopped.pt", SETTINGS, PLAN, 0)
    assert not (tmp_path / "stopped.pt").exists()
    found = learn_rounds(examples, REEFS, tmp_path / "stopped.pt", SETTINGS, PLAN, 0)
    assert done == ["one", "two", "one", "two", "two"]
    assert all(torch.equal(value, found.weights[key]) for key, value in wanted.weights.items())


def test_nobody_learns_on_a_hidden_split(examples, tmp_path):
    hidden = Reef(dataclasses.replace(SPLIT, hidden=True), "one")
    with pytest.raises(LabelError, match="expected reefs to learn on, got those of a hidden split"):
        learn_rounds(examples, [hidden], tmp_path / "a.pt", SETTINGS, PLAN, 0)


def test_two_reefs_of_one_name_are_refused(examples, tmp_path):
    other = Reef(dataclasses.replace(SPLIT, name="other"), "one")
    with pytest.raises(MethodError, match="expected each name once, got 'one' 2 times"):
        learn_rounds(examples, [*REEFS, other], tmp_path / "a.pt", SETTINGS, PLAN, 0)


def test_rounds_do_not_take_the_place_of_another_training(examples, files, tmp_path):
    train(read_examples(files[0], NETWORK), tmp_path / "a.pt", SETTINGS, 0)
    with pytest.raises(MethodError, match="holds another training, or more rounds of this one; remove it"):
        learn_rounds(examples, REEFS, tmp_path / "a.pt", SETTINGS, PLAN, 0)


@pytest.fixture
def rolled(examples, monkeypatch):
    """Makes up the rollouts; returns the list of those made, by the number of their round."""
    done = []

    def made_up(reef, plan, number, made_by, **options):
        done.append(number)
        data = io.BytesIO()
        kept = {key: getattr(examples, key) for key in ("pixels", "senses", "looked", "action_values")}
        values = kept.pop("action_values") + number + plan.seconds
        np.savez(data, made_by=np.array(made_by[reef.name]), action_values=values, **kept)
        return data.getvalue()

    monkeypatch.setattr(dagger, "rollout", made_up)
    return done


def learnt(folder, examples, plan=PLAN, seed=0, settings=SETTINGS, **options):
    return learn_rounds(examples, REEFS, folder / "a.pt", settings, plan, seed, **options)


def test_rounds_that_start_over_and_are_stopped_resume_without_again(examples, files, tmp_path, rolled, monkeypatch):
    train(read_examples(files[0], NETWORK), tmp_path / "a.pt", SETTINGS, 0)
    old = (tmp_path / "a.pt").read_bytes()
    made_up = dagger.rollout

    def stopped(reef, number, **options):
        if number == 2:
            raise KeyboardInterrupt
        return made_up(reef, number=number, **options)

    monkeypatch.setattr(dagger, "rollout", stopped)
    with pytest.raises(KeyboardInterrupt):
        learnt(tmp_path, examples, again=True)
    monkeypatch.setattr(dagger, "rollout", made_up)
    assert rolled == [1, 1]
    assert (tmp_path / "a.pt").read_bytes() == old
    found = learnt(tmp_path, examples)
    assert rolled == [1, 1, 2, 2]
    assert read_checkpoint(tmp_path / "a.pt").identity == found.identity
    # Another training that has taken its place since then was not to be replaced.
    train(read_examples(files[0], NETWORK), tmp_path / "a.pt", SETTINGS, 1, again=True)
    with pytest.raises(MethodError, match="holds another training"):
        learnt(tmp_path, examples)


def longer(monkeypatch):
    return dataclasses.replace(PLAN, seconds=4.0)


def of_another_release(monkeypatch):
    monkeypatch.setattr(dagger, "PROGRAM", "oysterbench 0.9")
    return PLAN


def with_another_expert(monkeypatch):
    monkeypatch.setattr(dagger, "steering_source", lambda: "as edited")
    return PLAN


@pytest.mark.parametrize("changed", [longer, of_another_release, with_another_expert])
def test_other_rollouts_do_not_take_the_place_of_those_learnt_from(examples, tmp_path, rolled, monkeypatch, changed):
    learnt(tmp_path, examples)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}
    rolled.clear()
    with pytest.raises(MethodError, match=r"round-1\.pt: holds a training on rollouts of another length"):
        learnt(tmp_path, examples, changed(monkeypatch))
    assert rolled == []
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()} == before


def test_only_a_training_of_the_same_plan_is_replaced_by_its_rounds(examples, tmp_path, rolled):
    train(examples, tmp_path / "a.pt", SETTINGS, 0)
    learnt(tmp_path, examples, ONE)
    two = learnt(tmp_path, examples)
    for plan, seed in ((ONE, 0), (PLAN, 1)):
        with pytest.raises(MethodError, match="or choose another --out"):
            learnt(tmp_path, examples, plan, seed)
    shutil.rmtree(tmp_path / "a.rounds")
    more_steps = dataclasses.replace(SETTINGS, fit=dataclasses.replace(SETTINGS.fit, steps=5))
    for settings, seed in ((SETTINGS, 1), (more_steps, 0)):
        with pytest.raises(MethodError, match="holds another training, or more rounds of this one"):
            learnt(tmp_path, examples, ONE, seed, settings)
    assert read_checkpoint(tmp_path / "a.pt").identity == two.identity
    assert learnt(tmp_path, examples, ONE, 1, again=True).finished


def test_the_command_trains_and_says_how_good_it_is(files, home):
    from click.testing import CliRunner

    from oysterbench.cli.main import main

    data = str(files[0])
    words = ["train", "steering", "--data", data, "--val", str(files[1]), "--steps", "1", "--threads", "1"]
    result = CliRunner().invoke(main, words, catch_exceptions=False)
    assert result.exit_code == 0, result.stderr
    path = home / "models" / "steering.pt"
    assert result.stdout.strip() == str(path)
    assert "training steering on 10 views: 1 of 1 steps" in result.stderr
    assert f"{files[1]}: skill " in result.stderr
    assert "on 10 views" in result.stderr
    assert read_checkpoint(path).finished
