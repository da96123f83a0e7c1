"""Times of poses, held against the recording of their sequence before anything is sent or scored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oysterbench.core.ros import EPOCH_NS
from oysterbench.core.trajectory import Trajectory
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.reading.times import check_times, outside_notes
from tests.helpers.pool import NAMES, estimate, tum, zipped
from tests.helpers.submissions_read import opened, wanted_of

BEGIN, END = EPOCH_NS, EPOCH_NS + 20_000_000_000
EVERY = np.arange(BEGIN, END, 100_000_000)


def at(stamps_ns) -> Trajectory:
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    return Trajectory(stamps, np.zeros((len(stamps), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1)))


def test_the_recording_of_a_sequence_is_known_from_its_recipe(served):
    assert wanted_of(served, "pool-test").spans == dict.fromkeys(NAMES, (BEGIN, END))


@pytest.mark.parametrize(
    ("stamps", "advice"),
    [
        (EVERY - BEGIN, f"if they count from the start of the sequence, add {EPOCH_NS // 10**9}.0"),
        (EVERY // 10**9, "its timestamps are in s: write seconds"),
        (EVERY + 10**15, "keep the timestamps of the messages of that sequence"),
        (EVERY - 10**15, "keep the timestamps of the messages of that sequence"),
    ],
    ids=["from zero", "seconds as nanoseconds", "later", "earlier"],
)
def test_a_path_at_other_times_is_refused_with_what_to_do(stamps, advice):
    seen = r"x\.tum: no pose is at a time of its sequence: they are at .* s, pool-01 is"
    with pytest.raises(Refusal, match=seen) as why:
        check_times(at(stamps), "x.tum", "pool-01", (BEGIN, END))
    assert advice in why.value.reason


def test_poses_beyond_begin_and_end_are_counted_in_a_note_and_no_reason_to_refuse(served, tmp_path):
    path = estimate(0)
    late = replace(path, stamps_ns=path.stamps_ns + 5_000_000_000)  # 20 s long, of which 5 are left over
    wanted = wanted_of(served, "pool-test")
    _, facts = opened(tmp_path, zipped({"pool-01.tum": tum(late, tmp_path)}), wanted)
    assert facts["notes"] == ["pool-01: 48 of 200 poses are before its begin or after its end, and are not scored"]
    assert outside_notes(path, "pool-01", (BEGIN, END)) == []
    assert outside_notes(late, "pool-01", None) == [], "a server that does not tell"


def test_an_upload_at_other_times_is_refused_by_its_file(served, tmp_path):
    path = estimate(0)
    relative = replace(path, stamps_ns=path.stamps_ns - EPOCH_NS)
    with pytest.raises(Refusal, match=r"^pool-01\.tum: no pose is at a time of its sequence: they are at 0\.0"):
        opened(tmp_path, zipped({"pool-01.tum": tum(relative, tmp_path)}), wanted_of(served, "pool-test"))


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("pool-01.tum", "1763596800000 0 0 0 0 0 0 1\n1763596800100 0 0 0 0 0 0 1\n", "or nanoseconds; write seconds"),
        ("pool-01.csv", "17635968.5,0,0,0,1,0,0,0\n17635969.5,0,0,0,1,0,0,0\n", "name the columns in a header"),
        ("pool-01.tum", "2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "sort the poses by time"),
        ("pool-01.tum", "1 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n", "keep one of them"),
        ("pool-01.tum", "1 0 0 0 0 1 0 0 0 0 1 0\n", "write lines of TUM"),
    ],
)
def test_no_option_is_advised_that_a_submission_lacks(served, tmp_path, name, text, told):
    with pytest.raises(Refusal) as why:
        opened(tmp_path, zipped({name: text.encode()}), wanted_of(served, "pool-test"))
    assert why.value.reason.endswith(told)
