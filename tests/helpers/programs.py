"""Other people's programs, in a few lines each, as `oysterbench run --command` starts them."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

PROGRAMS = {
    "copies": "import shutil; shutil.copy(argv[0], argv[2])",
    "sleeps": "import time; print('still here', file=sys.stderr, flush=True); time.sleep(600)",
    "crashes": "import signal; os.kill(os.getpid(), signal.SIGSEGV)",
    "killed": "import signal\n"
    "open(argv[0] + '.log', 'a').write('run\\n')\n"
    "if len(open(argv[0] + '.log').readlines()) == 1: os.kill(os.getpid(), signal.SIGKILL)\n"
    "import shutil; shutil.copy(argv[0], argv[2])",
    "killed_in_a_shell": "sys.exit(137)",
    "full": "sys.exit(f'cannot write map.bin: {os.strerror(28)}')",
    "refuses": "print('first'); sys.stderr.write('no vocabulary\\ngiving up\\n'); sys.exit(3)",
    # Its fourth argument gets the first half of the path, or the fifth argument where there is one.
    "leaves_both": "import shutil; shutil.copy(argv[0], argv[2])\n"
    "lines = open(argv[0]).readlines()\n"
    "open(argv[3], 'w').writelines(argv[4:] or lines[: len(lines) // 2])",
    "explains": "sys.exit('\\n'.join(f'frame {k}: ' + 90 * '.' for k in range(30)))",
    "silent": "pass",
    "garbage": "open(argv[2], 'w').write('tracking lost at frame 7\\n')",
    "empty": "open(argv[2], 'w').close()",
    "talks": "import shutil; sys.stderr.write('x' * 79 + '\\n' * 1)\n"
    "for _ in range(60_000): print('y' * 79)\n"
    "shutil.copy(argv[0], argv[2])",
    # A child in a session of its own whose parent is gone: what is called a daemon.
    "leaves": "import shutil, time\n"
    "if os.fork() == 0:\n"
    "    os.setsid()\n"
    "    if os.fork() == 0:\n"
    "        open(argv[0] + '.pid', 'w').write(str(os.getpid())); time.sleep(600)\n"
    "    os._exit(0)\n"
    "os.wait()\n"
    "while not (os.path.exists(argv[0] + '.pid') and open(argv[0] + '.pid').read()): time.sleep(0.01)\n"
    "shutil.copy(argv[0], argv[2])",
    # The work is done by a child: 150 MB and half a second of processor time.
    "works": "import shutil, time\n"
    "if os.fork() == 0:\n"
    "    block = bytearray(150_000_000)\n"
    "    while time.process_time() < 0.5: pass\n"
    "    os._exit(0)\n"
    "os.wait()\n"
    "shutil.copy(argv[0], argv[2])",
    # Ends when as many of its like have begun as its fourth argument says.
    "meets": "import shutil, time\n"
    "open(f'{argv[0]}.{os.getpid()}', 'w').close()\n"
    "folder, name = os.path.split(argv[0])\n"
    "while sum(n.startswith(name + '.') for n in os.listdir(folder)) < int(argv[3]): time.sleep(0.01)\n"
    "shutil.copy(argv[0], argv[2])",
    # Notes each of its runs; from the second on it waits until a file is there.
    "waits": "import shutil, time\n"
    "open(argv[0] + '.log', 'a').write('run\\n')\n"
    "if len(open(argv[0] + '.log').readlines()) > 1:\n"
    "    open(argv[0] + '.pid', 'w').write(str(os.getpid()))\n"
    "    while not os.path.exists(argv[0] + '.go'): time.sleep(0.01)\n"
    "shutil.copy(argv[0], argv[2])",
    # Notes the number of its run, its fourth argument; all but the first wait until a file is there.
    "holds": "import shutil, time\n"
    "open(argv[0] + '.log', 'a').write(argv[3] + '\\n')\n"
    "if argv[3] != '0':\n"
    "    open(f'{argv[0]}.pid{argv[3]}', 'w').write(str(os.getpid()))\n"
    "    while not os.path.exists(argv[0] + '.go'): time.sleep(0.01)\n"
    "shutil.copy(argv[0], argv[2])",
    "counts": "import shutil; open(argv[0] + '.log', 'a').write(argv[3] + '\\n'); shutil.copy(argv[0], argv[2])",
}


def command(folder: Path, program: str, given: Path, form: str = "mcap", *more: str) -> str:
    """The command line of a program: argv is the file `given`, the input in its form, the output, and what follows."""
    path = folder / f"{program}.py"
    path.write_text(f"import os, sys\nargv = sys.argv[1:]\n{PROGRAMS[program]}\n")
    words = [sys.executable, "-I", "-S", path, given]
    return " ".join([*(shlex.quote(str(word)) for word in words), f"{{{form}}}", "{out}", *more])
