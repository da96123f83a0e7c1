"""What a program says while it runs."""

from __future__ import annotations

import pytest

from oysterbench.methods.run_output import RunOutput, read_output


@pytest.mark.parametrize(
    ("stdout", "stderr", "heard"),
    [
        ("", "", RunOutput()),
        ("loading\nmapping\n", "", RunOutput(line="mapping")),
        ("", "warning\n", RunOutput(line="warning")),
        ("progress 12 of 70\nloop closed\nprogress 13 of 70\n", "", RunOutput(13, 70, "loop closed")),
        ("progress 12 of 70\nprogress 13 of 7", "", RunOutput(12, 70)),  # a line that is not at its end
        ("progress 12 of 70\r\x1b[2Kprogress 13 of 70\r", "", RunOutput(12, 70, "[2Kprogress 13 of 70")),
        ("progress 80 of 70\n", "", RunOutput(70, 70)),
        ("making progress 3 of 4\n", "", RunOutput(line="making progress 3 of 4")),
    ],
)
def test_lines_on_progress_and_other_ones_are_told_apart(stdout, stderr, heard, tmp_path):
    (tmp_path / "stdout.txt").write_text(stdout, newline="")
    (tmp_path / "stderr.txt").write_text(stderr)
    assert read_output(tmp_path) == heard


def test_what_has_not_begun_says_nothing(tmp_path):
    assert read_output(tmp_path) == RunOutput()
