"""What a server takes for the ground truth of a split."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import ResultError
from oysterbench.sequence.cut import cut_public
from oysterbench_leaderboard.submissions.catalogue import serve_split
from tests.helpers.pool import lay_split


def test_a_truth_of_another_split_is_refused(tmp_path):

    recipe, truth = lay_split(tmp_path, "pool-test")
    _, other = lay_split(tmp_path, "pool-val")
    with pytest.raises(ResultError, match="expected split 'pool-test', got 'pool-val'"):
        serve_split(str(recipe), other)
    with pytest.raises(ResultError, match="is hidden: expected --truth"):
        serve_split(str(recipe))
    (truth / "pool-02.mcap").unlink()
    with pytest.raises(ResultError, match=r"expected .*pool-02\.mcap"):
        serve_split(str(recipe), truth)


def test_files_as_teams_get_them_are_no_truth(tmp_path):
    recipe, truth = lay_split(tmp_path, "pool-test")
    path = truth / "pool-02.mcap"
    with open(tmp_path / "public", "wb") as file:
        cut_public(path, file)
    (tmp_path / "public").replace(path)
    with pytest.raises(ResultError, match=r"pool-02\.mcap: expected ground truth, got a file as teams get it; "):
        serve_split(str(recipe), truth)
