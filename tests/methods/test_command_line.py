"""Command lines of external programs: shells in them, placeholders in quotes, files that they name."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from oysterbench.core.errors import MethodError
from oysterbench.methods.adapters import ExternalCommand
from oysterbench.methods.command_line import files_named, filled, scripts_in

ODD = ["/a b", "/it's", '/"x"', "/x;echo hi", "/$(echo hi)`echo hi`", "/back\\slash\\", "/new\nline", "/ü & | > *?~#{}"]


@pytest.mark.parametrize("path", ODD)
@pytest.mark.parametrize("shell", ["sh", "bash"])
@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("printf %s {out}", "P"),
        ('printf %s "{out}"', "P"),
        ("printf %s '{out}'", "P"),
        ('printf %s "$(printf %s {out})"', "P"),
        ('printf %s "it\'s $(printf %s "{out}")"', "it's P"),
        ("(printf %s a) # don't\nprintf %s \\'{out}\\\\{out}", "a'P\\P"),
        ("printf %s ${{#}}--config={out}/x", "0--config=P/x"),
        ("printf %s $((1 << 2)){out}", "4P"),
        ('printf %s "$(( (1 + 1) * 2 ))$( (printf %s {out}) ){out}"', "4PP"),
        ("((printf %s 'a)'); printf %s '{out}')", "a)P"),
        ('x=$(case a in a) printf %s {out};; esac); printf %s "$x"', "P"),
        ('printf %s "${{PWD:+"a}}b"}}$(printf %s "${{x:-$(printf %s {out})}}")"', "a}bP"),
        ("printf %s ${{x:-'{out}'}}", "P"),
        ('eval "$(printf %s x=a)"; printf %s "$x"{out}', "aP"),
        ("case {out} in *) printf %s {out};; esac", "P"),
        ("printf '%s' eval; true > /dev/null && sh -c 'printf %s \"$0\"' {out} > {dev}", "eval"),
    ],
)
def test_a_placeholder_in_a_shells_commands_is_one_word_whatever_its_value(script, said, path, shell):
    words = filled([shell, "-c", script], {"out": path, "dev": "/dev/null"})
    done = subprocess.run(words, capture_output=True, text=True, check=True, env={"PATH": "/usr/bin:/bin"})
    assert done.stdout == said.replace("P", path)
    assert done.stderr == ""


@pytest.mark.parametrize("path", ODD)
def test_quotes_with_escapes_end_where_they_end(path):
    words = filled(["bash", "-c", "printf %s $'it\\'s '{out}"], {"out": path})
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == (f"it's {path}", "")


def test_a_placeholder_elsewhere_is_replaced_as_it_is():
    assert filled(["prog", "a;{out}", "-c", "'{out}'"], {"out": "/a b"}) == ["prog", "a;/a b", "-c", "'/a b'"]
    assert filled(["sh", "-c", '"$1"', "sh", "{out}"], {"out": "/a b"}) == ["sh", "-c", '"$1"', "sh", "/a b"]


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ("prog `dirname {out}` {mcap}", r"\{out\} is in backquotes: write \$\(\.\.\.\)"),
        ("cat <<E\n{mcap} {out}\nE", r"\{mcap\} is in a here-document"),
        ("prog {mcap} <<E\nx\nE\nmv x {out}", r"\{out\} is in a here-document or after one, .*: write sh -c '"),
        ("prog $'{mcap}' {out}", r"\{mcap\} is in \$'\.\.\.'"),
        ("prog \\{mcap} {out}", r"\{mcap\} is after a backslash"),
        ("prog {mcap} # {out}", r"\{out\} is in a comment"),
        ('prog {mcap} "$(case x in x) dirname {out};; esac)"', r"\{out\} is after case in a quoted \$\("),
        ('prog {mcap} "$(case x in\n  (x) a;; esac)" {out}', r"\{out\} is after case in"),
        ('prog {mcap} "${{x:-"{out}"}}"', r"\{out\} is in \"\$\{\.\.\.\}\", where"),
        ('prog {mcap} "${{x:-a ${{y}} {out}}}"', r"\{out\} is in \"\$\{"),
        ('eval "prog {mcap} {out}"', r"\{mcap\} is in a command of eval, where"),
        ("eval 'prog \"$1\"' {mcap} {out}", r"\{mcap\} is in a command of eval"),
        ("prog {mcap}; if A=1 eval $(options) {out}; then a; fi", r"\{out\} is in a command of eval"),
        ('f() {{ eval "cd $(dirname {out})"; }}; f {mcap}', r"\{out\} is in a command of eval"),
        ("prog {mcap} \"$(sh -c 'prog {out}')\"", r"\{out\} is in a shell within a shell"),
        ('bash -c "cd $(dirname {out}) && prog" {mcap}', r"\{out\} is in a shell within a shell"),
        ("env A=1 bash -c 'prog {mcap}' {out}", r"\{mcap\} is in a shell within a shell: write sh -c"),
    ],
)
def test_a_placeholder_that_cannot_be_quoted_is_refused(script, why):
    with pytest.raises(MethodError, match=why):
        ExternalCommand(f"sh -c {subprocess.list2cmdline([script])}", "mine")


@pytest.mark.parametrize(
    ("line", "sign"),
    [
        ("cat {mcap} > {out}", ">"),
        ("cat {mcap} >{out}", ">{out}"),
        ("cat < {mcap} -o {out}", "<"),
        ("true {mcap} && cp a {out}", "&&"),
        ("true {mcap} | tee {out}", "|"),
        ("true {mcap} {out} 2>&1", "2>&1"),
        ("true {mcap} {out} 2> /dev/null", "2>"),
        ("true {mcap} {out} >>/tmp/log", ">>/tmp/log"),
        ("true {mcap} {out} >>log", ">>log"),
        ("true {mcap} {out} 2>err.log", "2>err.log"),
        ("true {mcap} {out} &>log", "&>log"),
        ("true {mcap} {out} ; true", ";"),
    ],
)
def test_what_only_a_shell_understands_is_refused_outside_of_one(line, sign):
    with pytest.raises(MethodError, match=rf"{re.escape(repr(sign))} is for a shell, .*: start a shell with sh -c"):
        ExternalCommand(line, "mine")
    ExternalCommand(f"sh -c '{line}'", "mine")


def test_words_that_a_program_may_well_take_are_left_to_it():
    ExternalCommand("true {mcap} {out} '<none>' 'a > b' 'x|y' -> >=5 a;b 1", "mine")


def test_commands_of_shells_are_found_wherever_the_shell_is():
    assert scripts_in(["env", "A=1", "/bin/bash", "-lc", "x", "y"]) == {4}
    assert scripts_in(["docker", "run", "image", "sh", "-e", "-c", "x"]) == {6}
    assert scripts_in(["sh", "script.sh", "-c", "x"]) == set()
    assert scripts_in(["python3", "-c", "x"]) == set()


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A working folder with programs."""
    for name in ("bin/tool", "build/slam", "modprog/__main__.py", "lib/local.py", "cfg.yaml", "log.txt", "my prog"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("#!/bin/sh\n")
        path.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PWD", str(tmp_path))  # as a shell has it
    monkeypatch.setenv("PLACE", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PATH", f"{tmp_path}/bin:/usr/bin:/bin")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    return tmp_path


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("sh -c 'cd $(dirname {out}) && $PWD/build/slam {euroc} {out}'", {"build/slam"}),
        ("sh -c 'set -e; cd build; ./slam {euroc} {out} > ../log.txt 2>&1'", {"build/slam"}),
        ("bash -c 'A=1 tool --config=cfg.yaml {euroc} {out}'", {"bin/tool", "cfg.yaml"}),
        ("""sh -c 'x="$(cat cfg.txt cfg.yaml)"; tool {euroc} {out} # it isn'"'"'t'""", {"bin/tool", "cfg.yaml"}),
        ("sh -c 'bash -c \"./my\\ prog\" && tool {euroc} {out}'", {"bin/tool", "my prog"}),
        ("sh -c 'cd $PLACE/build && ./slam {euroc} {out}'", {"build/slam"}),
        ("sh -c 'cd ~/build && ./slam --config=~/cfg.yaml {euroc} {out}'", {"build/slam", "cfg.yaml"}),
        ("bash -c '\"${{PLACE}}/build/slam\" {euroc} {out}'", {"build/slam"}),
        ("env X=cfg.yaml nice -n 10 tool {euroc} {out}", {"bin/tool", "cfg.yaml"}),
        ("python3 -u -m modprog {euroc} {out}", {"modprog"}),
        ("python3 -W ignore -Im modprog {euroc} {out}", {"modprog"}),
        ("python3 cfg.yaml -m modprog {euroc} {out}", {"cfg.yaml"}),
        ("env PYTHONPATH=lib python3 -m local {euroc} {out}", {"lib/local.py"}),
        (f"sh -c '{'long ' * 100}{'x' * 300}; tool {{euroc}} {{out}}'", {"bin/tool"}),
    ],
)
def test_the_files_and_programs_that_a_command_line_names_are_found_in_shells_too(line, names, work):
    program = ExternalCommand(line, "mine")
    found = {Path(name).absolute() for name in program.identity["files"]}
    assert {str(path.relative_to(work)) for path in found if path.is_relative_to(work)} == names


def test_a_changed_file_changes_the_identity_and_is_the_only_one(work):
    program = ExternalCommand("sh -c './build/slam && python3 -m modprog {euroc} {out}'", "mine")
    before = program.identity["files"]
    (work / "modprog" / "part.py").write_text("a = 1\n")
    after = program.identity["files"]
    assert {name for name in after if before[name] != after[name]} == {"modprog"}
    (work / "build" / "slam").write_text("#!/bin/sh\nexit 5\n")
    last = program.identity["files"]
    assert {name for name in last if last[name] != after[name]} == {"build/slam"}


def test_folders_that_a_shell_changes_to_are_no_burden_however_many_and_whatever_their_names(work):
    there = "; ".join([f"cd {work}/build; cd ..; cd build; cd .."] * 20)
    words = ["sh", "-c", f"{there}; cd {'x' * 300}; cd build; ./slam"]
    assert Path("build/slam") in files_named(words)


def test_a_program_given_directly_is_identified_by_its_absolute_path_only(work):
    program = ExternalCommand("./build/slam {euroc} {out}", "mine")
    assert set(program.identity["files"]) == {str(work / "build" / "slam")}
    assert files_named([sys.executable, "--config=cfg.yaml"]) == {Path("cfg.yaml")}
