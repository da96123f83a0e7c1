"""Which paths the density track maps along: those of a folder, and those of methods that it runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import LabelError, MethodError, OysterbenchError, TrajectoryError
from oysterbench.core.trajectory import write_tum
from oysterbench.tracks import Request
from oysterbench.tracks.density import TRACK, estimates_in
from oysterbench.tracks.mapping_evaluation import camera_with_layers
from oysterbench.tracks.slam import TRACK as SLAM


@pytest.fixture
def paths_of(dive_file, tmp_path, monkeypatch):
    """Return a function: the paths that are mapped with these methods, beside a folder with estimates of `mine` and
    `dead_reckoning`, and what is said; nothing is mapped, and a method that is run fails."""
    truth = oysterbench.open(dive_file).truth()
    for name, aside in (("mine", 1.0), ("dead_reckoning", 2.0), ("truth", 0.0)):
        write_tum(tmp_path / f"hand-made-{name}.tum", replace(truth, positions=truth.positions + aside))
    ran: list[str] = []
    mapped = []

    def run(sequences, adapters, settings, request):
        ran.extend(adapter.name for adapter in adapters)
        return []

    monkeypatch.setattr(SLAM, "run", run)
    monkeypatch.setattr(TRACK, "run", lambda *rest: [])
    monkeypatch.setattr(
        "oysterbench.tracks.mapping_evaluation.evaluate_maps", lambda one, *rest: mapped.append(one) or []
    )

    def call(*methods, **options):
        said: list[str] = []
        request = Request(
            tmp_path / "out",
            places=[dive_file],
            methods=methods,
            options={"poses": tmp_path, **options},
            announce=said.append,
        )
        TRACK.evaluate(request)
        paths = {
            name: path if isinstance(path, Exception) else path.positions[0, 0]
            for name, path in mapped[-1].paths.items()
        }
        return paths, ran, said

    return call


def test_estimates_in_a_folder_are_used_and_their_method_is_not_run(paths_of):
    found, ran, said = paths_of("dead_reckoning")
    assert found == {"dead_reckoning": pytest.approx(2.0)}
    assert (ran, said) == ([], [])


def test_a_method_beside_a_folder_selects_among_its_estimates(paths_of):
    assert list(paths_of("mine")[0]) == ["mine"]
    assert list(paths_of()[0]) == ["dead_reckoning", "mine"]
    assert list(paths_of("none")[0]) == ["dead_reckoning", "mine"], "it has masks, not a path"


def test_a_method_without_estimates_in_the_folder_is_run_and_that_is_said(paths_of):
    _, ran, said = paths_of("visual_only")
    assert ran == ["visual_only"]
    assert "has no estimates of visual_only, which is therefore run" in said[0]


@pytest.mark.parametrize("name", ["nobody", "truth"])
def test_a_method_neither_in_the_folder_nor_known_is_refused(paths_of, name):
    with pytest.raises(
        MethodError, match=f"has no estimates SEQUENCE-{name}.tum, and: unknown method '{name}'"
    ) as error:
        paths_of(name)
    assert "\n" not in str(error.value)


def test_a_sequence_without_an_estimate_is_a_failure_of_the_method(paths_of, tmp_path):
    (tmp_path / "hand-made-mine.tum").rename(tmp_path / "other-mine.tum")
    assert "has no hand-made-mine.tum" in str(paths_of("mine")[0]["mine"])


def test_a_sequence_without_any_estimate_is_a_failure_of_the_method_that_was_named(paths_of, tmp_path):
    """The other sequences of a split are still mapped."""
    for name in ("mine", "dead_reckoning"):
        (tmp_path / f"hand-made-{name}.tum").rename(tmp_path / f"other-{name}.tum")
    assert "has no hand-made-mine.tum" in str(paths_of("mine")[0]["mine"])
    with pytest.raises(TrajectoryError, match="expected estimates of hand-made, "):
        paths_of()


def test_estimates_of_a_sequence_whose_name_begins_alike_are_not_taken(tmp_path):
    for name in ("dive-mine", "dive-truth", "dive-2-mine", "dive-2-truth", "dive-mine.online"):
        (tmp_path / f"{name}.tum").touch()
    assert estimates_in(tmp_path, "dive") == {"mine": tmp_path / "dive-mine.tum"}
    assert estimates_in(tmp_path, "dive-2") == {"mine": tmp_path / "dive-2-mine.tum"}


def test_estimates_without_ground_truth_beside_them_are_told_apart_by_the_names_of_the_sequences(tmp_path):
    names = ("dive", "dive-2")
    for name in ("dive-mine", "dive-2-mine", "dive-m-truth", "dive-m-2"):
        (tmp_path / f"{name}.tum").touch()
    assert list(estimates_in(tmp_path, "dive", names)) == ["m-2", "m-truth", "mine"]
    assert list(estimates_in(tmp_path, "dive-2", names)) == ["mine"]


def test_paths_of_the_users_other_sequences_are_not_mapped(paths_of, tmp_path):
    for name in ("hand-made-2-truth", "hand-made-2-mine"):
        (tmp_path / f"{name}.tum").touch()
    assert list(paths_of()[0]) == ["dead_reckoning", "mine"]


def test_estimates_of_methods_whose_options_have_decimal_points_are_used(paths_of, tmp_path):
    for name in ("mine[gain=0.5]", "mine[gain=2]"):
        (tmp_path / f"hand-made-{name}.tum").write_bytes((tmp_path / "hand-made-mine.tum").read_bytes())
    (tmp_path / "hand-made-mine[gain=0.5].online.tum").touch()
    assert list(paths_of()[0]) == ["dead_reckoning", "mine", "mine[gain=0.5]", "mine[gain=2]"]
    found, ran, _ = paths_of("mine[gain=0.5]")
    assert (list(found), ran) == (["mine[gain=0.5]"], [])


def test_an_estimate_that_cannot_be_read_is_a_failure_of_its_method_alone(paths_of, tmp_path):
    (tmp_path / "hand-made-mine.tum").write_text("no pose\n")
    found, _, _ = paths_of()
    assert isinstance(found["mine"], TrajectoryError)
    assert found["dead_reckoning"] == pytest.approx(2.0)


class Turns:
    """Has the name of another method."""

    name, track = "dead_reckoning", "slam"

    def run(self, sequence):
        raise NotImplementedError


@pytest.mark.parametrize("poses", [(), ("poses",)])
def test_two_methods_of_one_name_are_refused(tmp_path, poses):
    mine = f"{__name__}:Turns"
    request = Request(tmp_path, methods=["dead_reckoning", mine], options=dict.fromkeys(poses, tmp_path))
    with pytest.raises(MethodError, match=r"^dead_reckoning and .*:Turns are both named 'dead_reckoning': give"):
        TRACK._named(request)


def test_each_map_is_kept_once_it_is_made(dive_file, tmp_path, monkeypatch):
    monkeypatch.setattr("oysterbench.tracks.mapping_evaluation.evaluate_maps", lambda *rest: iter("ab"))
    monkeypatch.setattr("oysterbench.report.density_figure.drawn", lambda run: run)
    monkeypatch.setattr(TRACK, "show", lambda runs, *rest: runs)
    monkeypatch.setattr(SLAM, "run", lambda *rest: [])
    kept: list[list[str]] = []
    TRACK.evaluate(Request(tmp_path, places=[dive_file], finished=lambda runs: kept.append(list(runs))))
    assert kept == [["a"], ["a", "b"]]


def test_methods_are_run_with_the_alignment_and_the_gaps_of_the_maps(dive_file, tmp_path, monkeypatch):
    """A vertical path, of which posyaw finds no yaw, is refused only if maps are to be aligned by it."""
    asked = []
    monkeypatch.setattr(SLAM, "run", lambda sequences, adapters, settings, request: asked.append(settings) or [])
    monkeypatch.setattr("oysterbench.tracks.mapping_evaluation.evaluate_maps", lambda *rest: [])
    TRACK.evaluate(Request(tmp_path, places=[dive_file], options={"align": "origin", "max_gap_s": 0.5, "cell_m": 2.0}))
    assert [(one.align, one.max_gap_s) for one in asked] == [("origin", 0.5)]


def _cameras(path):
    opened = oysterbench.open(path)
    return opened.name, opened.cameras, {topic for topic, _, _ in opened.contents()}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"masks": "nomasks"}, r"nomasks: expected a \.png, \.npy or \.npz per image, got none"),
        ({"masks": "small"}, r"at \d+ ns: expected \d+ x \d+ px, as the images of .*, got 3 x 2"),
        ({"masks": "elsewhere"}, r"took no image at 5 ns: are the masks of another sequence"),
        ({"masks": "damaged"}, r"\.png"),
        ({"max_gap_s": float("inf")}, r"max_gap_s.*expected more than 0 s, got inf"),
        ({"cell_m": float("inf")}, r"cell_m: expected a finite number, got inf"),
    ],
)
def test_masks_and_settings_that_cannot_be_used_are_refused_before_methods_are_run(
    dive_file, tmp_path, monkeypatch, options, message
):
    camera = camera_with_layers(*_cameras(dive_file))
    stamp = next(oysterbench.open(dive_file).images(camera)).stamp_ns
    for folder, name in (("nomasks", ""), ("small", stamp), ("elsewhere", 5), ("damaged", stamp)):
        (tmp_path / folder).mkdir()
        if name:
            cv2.imwrite(str(tmp_path / folder / f"{camera}_{name}.png"), np.zeros((2, 3), np.uint8))
    (tmp_path / "damaged" / f"{camera}_{stamp}.png").write_bytes(b"cut off")
    ran = []
    monkeypatch.setattr(SLAM, "run", lambda *rest: ran.append(rest) or [])
    given = {key: tmp_path / value if key == "masks" else value for key, value in options.items()}
    with pytest.raises(LabelError if "masks" in options else OysterbenchError, match=message):
        TRACK.evaluate(Request(tmp_path / "out", places=[dive_file], options=given))
    assert ran == []


def test_masks_called_truth_are_those_of_the_ground_truth_unless_a_folder_is_called_so(paths_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert paths_of("mine", masks=Path("truth"))[0] == {"mine": pytest.approx(1.0)}
    (tmp_path / "truth").mkdir()
    with pytest.raises(LabelError, match=r"truth: expected a \.png, \.npy or \.npz per image, got none"):
        paths_of("mine", masks=Path("truth"))
