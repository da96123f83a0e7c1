"""The rows of an EuRoC folder as the drivers read them, in C++."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.helpers.paths import BASELINES

PROGRAM = """
#include "folder.h"

int main(int, char **argv) {
  const auto found = taken_together(argv[1], std::stoul(argv[2]), std::stoll(argv[3]));
  for (const auto &rows : found) {
    for (const ImageRow &row : rows)
      std::cout << row.stamp_ns << ' ';
    std::cout << std::endl;
  }
  return found.empty();
}
"""
MS = 1_000_000
Together = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("there is no C++ compiler here")
    folder = tmp_path_factory.mktemp("driver")
    (folder / "main.cpp").write_text(PROGRAM)
    command = [compiler, "-std=c++17", "-Wall", "-Werror", f"-I{BASELINES / 'external' / 'common'}", "main.cpp"]
    subprocess.run([*command, "-o", "program"], cwd=folder, check=True)
    return folder / "program"


@pytest.fixture
def together(program: Path, tmp_path: Path) -> Together:
    def run(*cameras: Sequence[int], tolerance_ns: int = MS) -> subprocess.CompletedProcess[str]:
        for n, stamps in enumerate(cameras):
            folder = tmp_path / f"cam{n}"
            folder.mkdir()
            (folder / "data.csv").write_text("".join(f"{stamp},{stamp}.png\n" for stamp in stamps))
        words = [str(program), f"{tmp_path}/", str(len(cameras)), str(tolerance_ns)]
        return subprocess.run(words, capture_output=True, text=True, check=False)

    return run


def stamps(done: subprocess.CompletedProcess[str]) -> list[list[int]]:
    return [[int(word) for word in line.split()] for line in done.stdout.splitlines()]


def test_pictures_are_a_pair_where_their_stamps_differ_by_no_more_than_the_tolerance(together):
    left, right = [0, 100 * MS, 200 * MS, 300 * MS], [1000, 100 * MS - 500, 202 * MS, 300 * MS]
    done = together(left, right)
    assert (done.returncode, done.stderr) == (0, "")
    assert stamps(done) == [[0, 1000], [100 * MS, 100 * MS - 500], [300 * MS, 300 * MS]]


def test_of_several_the_nearest_one_is_taken_and_what_has_none_is_left_out(together):
    done = together([0, 10 * MS, 20 * MS], [-3 * MS, -3 * MS, 2 * MS, 9 * MS, 12 * MS], tolerance_ns=5 * MS)
    assert stamps(done) == [[0, 2 * MS], [10 * MS, 9 * MS]]


def test_a_picture_whose_partner_was_lost_takes_no_neighbours(together):
    """At 100 Hz with a tolerance of 10 ms: each would be in two pairs."""
    done = together([10 * k * MS for k in range(6)], [20 * k * MS for k in range(3)], tolerance_ns=10 * MS)
    assert stamps(done) == [[0, 0], [20 * MS, 20 * MS], [40 * MS, 40 * MS]]
    done.check_returncode()


def test_one_camera_needs_no_other(together):
    assert stamps(together([0, 7])) == [[0], [7]]


def test_where_no_picture_has_another_it_says_so(together):
    done = together([0, 100 * MS], [50 * MS, 150 * MS])
    assert done.returncode == 1
    assert "no two pictures taken together: expected stamps of cam0 and cam1 within 1 ms of each other" in done.stderr


def test_a_folder_without_pictures_is_told_from_one_without_pairs(together):
    assert together([], [7]).stderr.endswith(": no pictures\n")
