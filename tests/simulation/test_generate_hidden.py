"""Hidden splits: nothing without a salt, other data with another, and the salt shows nowhere."""

from __future__ import annotations

import hashlib
import traceback

import numpy as np
import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.core.errors import RecipeError
from oysterbench.recipe import load_split, split_names
from oysterbench.sequence import open_sequence
from oysterbench.simulation.generate import generate_split, split_folder
from oysterbench.simulation.salt import Salt, read_salt, salt_for
from oysterbench.simulation.simulated_sequence import build_sequence
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT, make_split

ONE, OTHER = b"0123456789abcdef-one", b"0123456789abcdef-two"
SHORT = TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 1.0")
HIDDEN = SHORT.replace("seed = 5", "seed = 5\nhidden = true").replace(
    "[sequence.path]", '[[sequence.drawn]]\nkey = "path.speed_m_s"\nbetween = [0.2, 0.4]\n\n[sequence.path]'
)


@pytest.fixture(autouse=True)
def no_salt_around(monkeypatch):
    monkeypatch.delenv("OYSTERBENCH_SALT", raising=False)
    monkeypatch.delenv("OYSTERBENCH_SALT_FILE", raising=False)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The hidden tiny split with two salts, and the public one of the same recipe."""
    folder = tmp_path_factory.mktemp("hidden")
    hidden, public = make_split(HIDDEN), make_split(HIDDEN.replace("hidden = true\n", ""))
    return {
        "one": generate_split(hidden, folder / "one", salt=ONE)["tiny-01"],
        "other": generate_split(hidden, folder / "other", salt=OTHER)["tiny-01"],
        "none": generate_split(public, folder / "none")["tiny-01"],
    }


@pytest.mark.parametrize("salt", [b"", b"short", b"a" * 40])
def test_a_hidden_split_is_not_made_without_a_good_salt(tmp_path, salt):
    with pytest.raises(RecipeError, match="split tiny is hidden: it needs a secret salt"):
        generate_split(make_split(HIDDEN), tmp_path, salt=salt)
    assert list(tmp_path.iterdir()) == []


def test_world_way_and_noise_are_other_ones_with_another_salt(files):
    sequences = {name: open_sequence(path) for name, path in files.items()}
    tables = {}
    for name, sequence in sequences.items():
        oysters = sequence.oysters()
        truth = sequence.truth()
        gyro = np.array([sample.gyro for sample in sequence.imu()])
        picture = next(iter(sequence.images("cam_front"))).pixels
        tables[name] = (oysters, truth.positions, gyro, picture)
    for a, b in (("one", "other"), ("one", "none"), ("other", "none")):
        assert not tables[a][0].equals(tables[b][0]), "oysters"
        assert np.abs(tables[a][1] - tables[b][1]).max() > 0.1, "m of the way"
        assert not np.array_equal(tables[a][2], tables[b][2]), "noise of the gyro"
        assert np.abs(tables[a][3].astype(int) - tables[b][3]).mean() > 1, "pictures"


def test_what_the_recipe_lets_be_drawn_is_drawn_with_the_salt():
    split = make_split(HIDDEN)
    speeds = {salt: build_sequence(split, "tiny-01", salt).recipe.path.speed_m_s for salt in (ONE, OTHER, b"")}
    assert len(set(speeds.values())) == 3
    assert all(0.2 <= speed <= 0.4 for speed in speeds.values())
    assert build_sequence(split, "tiny-01", ONE).recipe.drawn == ()


def test_the_same_salt_gives_the_same_bytes(files, tmp_path):
    again = generate_split(make_split(HIDDEN), tmp_path, salt=ONE)["tiny-01"]
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(files["one"].read_bytes()).digest()


def test_the_salt_is_in_no_file_and_in_no_name(files, home):
    folder = split_folder(make_split(HIDDEN), ONE)
    for shown in (ONE, ONE.hex().encode(), hashlib.sha256(ONE).hexdigest().encode(), hashlib.sha256(ONE).digest()):
        assert shown not in files["one"].read_bytes()
        assert shown[:12] not in str(folder).encode()


def test_a_salt_shows_in_no_message():
    salt = Salt(ONE)
    assert salt == ONE
    try:
        raise ValueError(f"{salt} {salt!r} {[salt]} {salt!s}")
    except ValueError:
        assert "0123456789" not in traceback.format_exc()


def test_a_salt_is_read_from_a_file_or_the_environment(tmp_path, monkeypatch):
    file = tmp_path / "salt"
    file.write_bytes(ONE + b"\n")
    assert read_salt() is None
    assert read_salt(file) == ONE
    monkeypatch.setenv("OYSTERBENCH_SALT", OTHER.decode())
    assert read_salt() == OTHER
    monkeypatch.setenv("OYSTERBENCH_SALT_FILE", str(file))
    assert read_salt() == ONE, "a file goes before"
    assert salt_for("public", False) == b"", "a public split takes none, whatever is around"


@pytest.mark.parametrize("weak", [b"", b"fifteen bytes..", b"abababababababababab", b"\n" * 40])
def test_a_salt_that_could_be_guessed_is_refused(tmp_path, weak):
    file = tmp_path / "salt"
    file.write_bytes(weak)
    with pytest.raises(RecipeError, match=r"the salt cannot be read: No such file .*; for a new split, `head -c 32 "):
        read_salt(file.with_name("none"))
    with pytest.raises(RecipeError, match=r"--salt-file: expected a salt of at least 16 bytes") as raised:
        read_salt(file)
    assert not weak.strip() or weak.decode() not in str(raised.value)


def run(tmp_path, *args):
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    recipe = tmp_path / "tiny.toml"
    recipe.write_text(HIDDEN.replace('rig = "tiny"', 'rig = "rig.toml"'))
    return CliRunner().invoke(main, ["render", str(recipe), "--workers", "1", "--out", str(tmp_path / "out"), *args])


def test_the_command_wants_a_salt_in_one_line(tmp_path):
    result = run(tmp_path)
    assert result.exit_code == 1
    assert result.stderr.startswith("oysterbench: split tiny is hidden")
    assert result.stderr.count("\n") == 1
    for hint in ("--salt-file", "OYSTERBENCH_SALT_FILE", "/dev/urandom"):
        assert hint in result.stderr


def test_the_command_reads_the_salt_and_tells_nothing_of_it(files, tmp_path):
    (tmp_path / "salt").write_bytes(ONE)
    result = run(tmp_path, "--salt-file", str(tmp_path / "salt"))
    assert result.exit_code == 0, result.stderr
    assert ONE.decode() not in result.output
    made, wanted = open_sequence(tmp_path / "out" / "tiny-01.mcap"), open_sequence(files["one"])
    assert made.metadata["digest"] == wanted.metadata["digest"]
    assert np.array_equal(made.truth().positions, wanted.truth().positions)


def test_a_salt_for_a_public_split_is_refused(tmp_path):
    (tmp_path / "salt").write_bytes(ONE)
    result = CliRunner().invoke(main, ["render", "slam-mini", "--salt-file", str(tmp_path / "salt")])
    assert result.exit_code == 1
    assert "only hidden splits take a salt" in result.stderr


def test_the_test_splits_are_hidden_and_the_others_are_not():
    hidden = {name for name in split_names() if load_split(name).hidden}
    assert hidden == {name for name in split_names() if name.endswith("-test")}
