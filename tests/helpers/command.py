"""The command line as its users type it: in a process of its own, or in this one; and what its refusals look like."""

from __future__ import annotations

import os
import re
import subprocess

from click.testing import CliRunner

from oysterbench.cli.main import main
from tests.helpers.paths import COMMAND


def start(*arguments, home=None):
    """The command in a process of its own."""
    environment = dict(os.environ)
    if home is not None:
        environment["OYSTERBENCH_HOME"] = str(home)
    return subprocess.run([COMMAND, *map(str, arguments)], capture_output=True, text=True, env=environment, check=False)


def run(*arguments, home=None):
    """The command in this process, which has loaded already what it needs; answered as one of its own would be."""
    environment = {} if home is None else {"OYSTERBENCH_HOME": str(home)}
    done = CliRunner().invoke(main, [str(argument) for argument in arguments], env=environment)
    return subprocess.CompletedProcess(arguments, done.exit_code, done.stdout, done.stderr)


def run_bare(*arguments, home, code=0, **environment):
    """The command in this process, with nothing set but its home and the variables given; its exit status is `code`."""
    clean = {key: None for key in os.environ if key.startswith("OYSTERBENCH")}
    env = clean | {"OYSTERBENCH_HOME": str(home)} | environment
    done = CliRunner().invoke(main, [str(argument) for argument in arguments], env=env)
    assert done.exit_code == code, done.stderr
    return done


def assert_one_line(result, pattern, code=1):
    """That a command ended with this code, and one line on stderr that has the pattern."""
    assert result.returncode == code, result.stderr
    assert result.stdout == ""
    assert re.fullmatch(rf"oysterbench: [^\n]*{pattern}[^\n]*\n", result.stderr), result.stderr
