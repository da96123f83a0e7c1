"""Tables of commands that a program leaves: read by stamp, whatever their order, and refused by file and line."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import MethodError
from oysterbench.methods.interfaces.steering import command_arrays, parse_commands, read_commands
from oysterbench.recipe import SteeringRecipe

TASK = SteeringRecipe(yaw_deg=(20.0, 0.0, -20.0), pitch_deg=(-10.0, 0.0, 10.0), altitude_m=(0.5, 2.0))
STRAIGHT = TASK.yaw_deg.index(0.0), TASK.pitch_deg.index(0.0)
HEAD = "stamp_ns,yaw,pitch"


def test_commands_come_in_the_order_of_the_pictures(tmp_path):
    (tmp_path / "commands.csv").write_text(f'{HEAD}\r\n20,1,0\r\n\r\n"10", 0,1\r\n')
    made = read_commands(tmp_path / "commands.csv", [10, 20], TASK)
    assert [(one.yaw, one.pitch) for one in made] == [(0, 1), (1, 0)]
    classes, yaw, pitch = command_arrays(made, TASK)
    assert classes.tolist() == [[0, 1], [1, 0]]
    assert yaw.argmax(axis=1).tolist() == [0, 1]
    assert pitch.sum(axis=1).tolist() == [1.0, 1.0]


def test_of_equal_probabilities_the_one_nearest_to_straight_is_commanded():
    columns = [f"{axis}_{i}" for axis in ("yaw", "pitch") for i in range(len(getattr(TASK, f"{axis}_deg")))]
    line = ",".join(["7", *["2"] * len(columns)])
    made = parse_commands(f"stamp_ns,{','.join(columns)}\n{line}".encode(), "commands.csv", TASK)
    classes, yaw, _ = command_arrays(made, TASK)
    assert tuple(classes[0]) == STRAIGHT
    assert yaw[0].tolist() == pytest.approx([1 / len(TASK.yaw_deg)] * len(TASK.yaw_deg))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{HEAD}\n10,1,0", "commands.csv: 1 of 2 images have no command, the first being 20"),
        (f"{HEAD}\n10,1,0\n20,1,99", "commands.csv:3: pitch: expected a class"),
        (f"{HEAD}\n10,1,0\n30,1,0", "commands.csv:3: no image has the stamp 30; the first is 10"),
        (f"{HEAD}\n10,1,0\n10,1,0", "commands.csv:3: the image 10 has two commands"),
        (f"{HEAD}\n10,1", "commands.csv:2: expected 3 values, got 2"),
        ("time,yaw\n10,1", "commands.csv:1: expected the columns stamp_ns,yaw,pitch or"),
    ],
)
def test_a_table_that_is_wrong_is_refused_by_its_line(tmp_path, text, message):
    (tmp_path / "commands.csv").write_text(text)
    with pytest.raises(MethodError, match=message):
        read_commands(tmp_path / "commands.csv", [10, 20], TASK)


def test_a_table_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(MethodError, match=r"commands\.csv: expected a table as text"):
        read_commands(tmp_path / "commands.csv", [10], TASK)
