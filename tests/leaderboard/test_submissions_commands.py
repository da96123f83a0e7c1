"""Commands of the track steering that are sent: what is read of them, and what they score."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.scoring import MISSING, evaluator, score_predictions
from tests.helpers.pool import IMAGES, NAMES, image_names, steered, zipped
from tests.helpers.submissions_read import npz, opened, wanted_of


def table(sequence: int, answers: list[list[object]], head: str = "stamp_ns,yaw,pitch") -> bytes:
    """A line for each picture of a sequence, the last picture first."""
    stamps = [name.rpartition("/")[2] for name in image_names(sequence)]
    lines = [",".join(map(str, [stamp, *row])) for stamp, row in zip(stamps, answers, strict=True)]
    return "\n".join([head, *reversed(lines)]).encode()


def test_commands_score_what_the_expert_would_have_gained(served, tmp_path):
    wanted = wanted_of(served, "pool-dive", "steering")
    made = [[[1, 1]] * IMAGES, steered(1)[0].tolist()]
    data = zipped({f"{name}.csv": table(k, made[k]) for k, name in enumerate(NAMES)})
    predictions, facts = opened(tmp_path, data, wanted)
    assert facts == {"kind": "commands", "sequences": list(NAMES), "poses": 0, "images": 2 * IMAGES, "notes": []}
    scored = score_predictions(predictions, wanted, served["pool-dive"].truth, "eel", "2026-11-01T00:00:00Z")
    straight, expert = (record.metrics for record in scored.results)
    named, worth = steered(0)
    lost = worth.max(axis=(1, 2)) - worth[:, 1, 1]
    chance = worth.max(axis=(1, 2)) - worth.mean(axis=(1, 2))
    assert straight["skill"] == pytest.approx(1 - lost.sum() / chance.sum())
    assert straight["yaw_accuracy"] == (named[:, 0] == 1).mean()
    assert (expert["skill"], expert["joint_accuracy"], expert["regret_oysters"]) == (1.0, 1.0, 0.0)
    assert [(r.evaluator_version, dict(r.settings)) for r in scored.results] == [evaluator("steering")] * 2
    assert scored.data_set["metrics"]["pictures"] == 2 * IMAGES
    assert scored.data_set["metrics"]["yaw_accuracy"] == pytest.approx((straight["yaw_accuracy"] + 1) / 2)
    assert scored.curves is None


def test_probabilities_are_weighed_and_the_likeliest_is_commanded(served, tmp_path):
    wanted = wanted_of(served, "pool-dive", "steering")
    head = "stamp_ns," + ",".join(f"{axis}_{i}" for axis in ("yaw", "pitch") for i in range(3))
    data = zipped({"pool-01.csv": table(0, [[2, 1, 1, 0, 0, 7]] * IMAGES, head)})
    predictions, facts = opened(tmp_path, data, wanted)
    assert facts["sequences"] == ["pool-01"]
    scored = score_predictions(predictions, wanted, served["pool-dive"].truth, "eel", "2026-11-01T00:00:00Z")
    classes, _ = steered(0)
    metrics = scored.results[0].metrics
    assert metrics["yaw_accuracy"] == (classes[:, 0] == 0).mean()
    turns = np.array([20.0, 0.0, -20.0])
    off = np.abs(turns[None] - turns[classes[:, 0]][:, None]) @ np.array([0.5, 0.25, 0.25])
    assert metrics["yaw_cost_deg"] == pytest.approx(off.mean())
    assert scored.results[1].failure == MISSING
    assert scored.data_set is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("stamp_ns", "stamp"), "pool-01.csv:1: expected the columns stamp_ns,yaw,pitch or"),
        (lambda t: t.replace(",1,1", ",1"), "pool-01.csv:2: expected 3 values, got 2"),
        (lambda t: t.replace(",1,1", ",1,3"), "pool-01.csv:2: pitch: expected a class from 0 to 2, got 3"),
        (lambda t: t.replace(",1,1", ",left,1"), "pool-01.csv:2: yaw: expected a whole number from 0, got 'left'"),
        (lambda t: t.replace(",1,1", ",-1,1"), "expected a whole number from 0, got '-1'"),
        (lambda t: t + "\n5,1,1", "pool-01.csv:5: no image has the stamp 5; the first is"),
        (lambda t: t + "\n" + t.split("\n")[1], "pool-01.csv:5: the image .* has two commands"),
        (lambda t: t.rpartition("\n")[0], "1 of 3 images have no command"),
        (lambda t: "", "pool-01.csv:1: expected the columns"),
        (lambda t: "\xff", "expected a table as text in UTF-8"),
    ],
)
def test_a_table_of_commands_that_is_wrong_is_told_by_its_line(served, tmp_path, change, message):
    text = change(table(0, [[1, 1]] * IMAGES).decode())
    with pytest.raises(Refusal, match=message):
        opened(tmp_path, zipped({"pool-01.csv": text.encode("latin1")}), wanted_of(served, "pool-steer", "steering"))


@pytest.mark.parametrize("share", ["-1", "nan", "inf", "x", "1_0"])
def test_what_is_no_probability_is_refused(served, tmp_path, share):
    head = "stamp_ns," + ",".join(f"{axis}_{i}" for axis in ("yaw", "pitch") for i in range(3))
    data = zipped({"pool-01.csv": table(0, [[1, share, 0, 1, 0, 0]] * IMAGES, head)})
    with pytest.raises(Refusal, match=r"pool-01\.csv:2: "):
        opened(tmp_path, data, wanted_of(served, "pool-steer", "steering"))


def test_other_files_are_no_commands(served, tmp_path):
    wanted = wanted_of(served, "pool-steer", "steering")
    with pytest.raises(Refusal, match=r"expected tables of commands .*, got arrays"):
        opened(tmp_path, npz(a=np.zeros(3)), wanted)
    with pytest.raises(Refusal, match=r"expected tables of commands \(.csv\)"):
        opened(tmp_path, b"{}", wanted)
    with pytest.raises(Refusal, match=r"is no name of pool-steer; expected SEQUENCE\.csv, the sequences being pool-01"):
        opened(tmp_path, zipped({"pool-01.tum": b"1 2 3"}), wanted)
