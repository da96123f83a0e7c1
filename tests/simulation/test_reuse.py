"""Files of some topics, made from those of other topics: the bytes that rendering gives, without rendering again."""

from __future__ import annotations

import re
import shutil

import pytest

from oysterbench.core.errors import SequenceError
from oysterbench.notebook.rendering import render_files
from oysterbench.recipe import parse_split
from oysterbench.sequence.cut import cut_to, topics_folder
from oysterbench.simulation import cost, generate
from oysterbench.simulation.generate import check_made_by, digest, generate_split, split_folder
from oysterbench.simulation.reuse import _whole_files
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

NAME = "tiny-01"
LEFT = ("/cam_left/*", "/tf_static")


def two_cameras(seed: int = 5):
    """A split whose only dive has two cameras; the images of one go through a video link, which codes them in order."""
    camera = TINY_RIG[TINY_RIG.index("[[camera]]") :]
    rig = TINY_RIG.replace("cam_front", "cam_left") + "video_mbit_s = 0.1\n" + camera.replace("cam_front", "cam_right")
    recipe = TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 1.0").replace("seed = 5", f"seed = {seed}")
    return parse_split(recipe, "tiny.toml", rig_source=rig)


SPLIT = two_cameras()


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """The file of the left camera, rendered."""
    return generate_split(SPLIT, tmp_path_factory.mktemp("left"), topics=LEFT)[NAME]


@pytest.fixture
def rendered(left, home):
    """The same, where `render` keeps it."""
    kept = topics_folder(split_folder(SPLIT), LEFT) / left.name
    kept.parent.mkdir(parents=True)
    shutil.copy(left, kept)
    return kept


@pytest.fixture
def jobs(monkeypatch):
    """Sources of the jobs that were done."""
    done = []
    make = generate.make_timed_part

    def counting(split, job, **more):
        done.append(job.source)
        return make(split, job, **more)

    monkeypatch.setattr(generate, "make_timed_part", counting)
    return done


def test_topics_that_a_file_of_more_topics_has_are_cut_from_it(rendered, jobs, tmp_path, capsys):
    wanted = ("/cam_left/image", "/cam_left/camera_info")
    made = render_files(SPLIT, workers=1, topics=wanted)[NAME]
    assert jobs == []
    assert made.parent == topics_folder(split_folder(SPLIT), wanted)
    assert made.read_bytes() == generate_split(SPLIT, tmp_path, topics=wanted)[NAME].read_bytes()
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f"{made.parent}: tiny-01: all topics are cut from {rendered.parent}, and not rendered again")
    assert [path.name for path in made.parent.iterdir()] == ["tiny-01.mcap"]


@pytest.mark.parametrize("more", [("/imu", "/truth/*"), ("/cam_right/*", "/imu")])
def test_frames_that_a_file_has_are_taken_into_one_that_needs_more(rendered, jobs, tmp_path, capsys, more):
    wanted = (*LEFT, *more)
    made = render_files(SPLIT, workers=1, topics=wanted)[NAME]
    assert set(jobs) == ({"", "cam_right"} if "/cam_right/*" in more else {""})
    jobs.clear()
    assert made.read_bytes() == generate_split(SPLIT, tmp_path, topics=wanted)[NAME].read_bytes()
    assert "cam_left" in jobs
    assert re.search(
        rf"{made.parent}: tiny-01: /cam_left/\S+, .* are taken from {rendered.parent}, and not rendered again\n",
        capsys.readouterr().err,
    )


def test_a_complete_file_takes_the_frames_of_smaller_ones_but_not_in_a_folder_of_its_own(rendered, jobs, tmp_path):
    made = render_files(SPLIT, workers=1)[NAME]
    assert set(jobs) == {"", "cam_right"}
    assert made.parent == split_folder(SPLIT)
    assert cost.measured(made.parent) == {}, "what the rest took is not told as the cost of the sequence"
    jobs.clear()
    again = render_files(SPLIT, tmp_path / "reproduced", workers=1)[NAME]
    assert set(jobs) == {"", "cam_left", "cam_right"}
    assert cost.measured(again.parent).keys() == {NAME}
    assert made.read_bytes() == again.read_bytes()


def test_a_camera_of_which_a_file_has_a_part_is_rendered(rendered, jobs, capsys):
    cut_to(rendered, rendered, ["/cam_left/image"])
    render_files(SPLIT, workers=1, topics=("/cam_left/*",))
    assert jobs.count("cam_left") == 10
    assert "not rendered again" not in capsys.readouterr().err


def test_a_damaged_file_is_passed_over_and_said(rendered, left, jobs, capsys):
    data = bytearray(left.read_bytes())
    data[len(data) // 2] ^= 255
    rendered.write_bytes(data)
    made = render_files(SPLIT, workers=1, topics=("/cam_left/image",))[NAME]
    assert jobs.count("cam_left") == 10
    assert f"not used: {rendered}: damaged; delete it" in capsys.readouterr().err
    cut_to(rendered, left, ["/cam_left/image"])
    assert made.read_bytes() == rendered.read_bytes()
    rendered.write_bytes(data[: len(data) // 2])
    render_files(SPLIT, workers=1, topics=("/cam_left/camera_info", "/imu"))
    assert f"not used: {rendered}: truncated or damaged" in capsys.readouterr().err


def test_a_file_of_another_recipe_is_not_taken(left, home, jobs):
    other = two_cameras(seed=6)
    kept = topics_folder(split_folder(other), LEFT) / left.name
    kept.parent.mkdir(parents=True)
    shutil.copy(left, kept)
    made = render_files(other, workers=1, topics=("/cam_left/image",))[NAME]
    assert jobs.count("cam_left") == 10
    cut_to(kept, left, ["/cam_left/image"])
    assert made.read_bytes() != kept.read_bytes()


def test_a_file_under_the_name_of_another_sequence_is_not_taken(left, tmp_path):
    copied, made_by, wanted = tmp_path / "tiny-02.mcap", digest(SPLIT), {"/cam_left/image"}
    shutil.copy(left, copied)
    assert list(_whole_files([left, copied], made_by, wanted, print)) == [left]
    assert _whole_files([copied], made_by, wanted, print) == {}
    with pytest.raises(SequenceError, match=r"tiny-02\.mcap: expected the sequence tiny-02, got tiny-01"):
        check_made_by(copied, SPLIT, made_by, LEFT)
