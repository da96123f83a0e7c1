"""Checks of the machine: processor, memory, GPU, shared memory, open files, temporary files, and containment."""

from __future__ import annotations

import ctypes
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from oysterbench.methods.sandbox import CLONE_NEWNET, CLONE_NEWUSER, can_hide
from oysterbench.notebook.doctor.finding import Finding, broken_by, in_bytes
from oysterbench.notebook.doctor.installed import installed_version

SHARED = Path("/dev/shm")
LEAST_SHARED = 1 << 28
"""Shared memory below which a warning is given, bytes: some batches of images for each of a few workers."""
LEAST_OPEN = 1024
LEAST_TEMPORARY = 2e9
"""Free temporary space below which a warning is given, bytes: the sequence of a run, as given to a method."""
ASK_S = 60.0
"""Time limit for a library to say whether it can use a GPU, s."""

ASKED = {
    "torch": "import torch; print(torch.cuda.is_available())",
    "warp-lang": "import warp; warp.config.log_level = warp.LOG_ERROR; print(warp.is_cuda_available())",
}
"""Package -> program, run in a process of its own, that prints whether the package can use a GPU."""

ISOLATED = f"import ctypes, sys; sys.exit(ctypes.CDLL(None).unshare({CLONE_NEWUSER | CLONE_NEWNET}) != 0)"
"""Program that tries to make a user namespace with a network of its own, as `sandbox` does."""


def look_at_machine() -> Iterator[Finding]:
    """Check the resources of the machine."""
    cores = len(os.sched_getaffinity(0))
    total, free = memory()
    where = ", in a container" if any(Path(mark).exists() for mark in ("/.dockerenv", "/run/.containerenv")) else ""
    detail = f"{cores} core{'s' if cores > 1 else ''}, {in_bytes(total)} of memory, {in_bytes(free)} free{where}"
    yield Finding("machine", "processor", "ok", detail)
    yield from gpus()
    yield shared_memory()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    few = 0 <= soft < LEAST_OPEN
    most = "no limit" if hard == resource.RLIM_INFINITY else f"at most {hard}"
    advice = f"ulimit -n {LEAST_OPEN if hard == resource.RLIM_INFINITY else min(hard, LEAST_OPEN)}" if few else ""
    yield Finding("machine", "open files", "poor" if few else "ok", f"{soft} at a time ({most})", advice)
    yield temporary()


def memory() -> tuple[int, int]:
    """Total and available memory, bytes; in a container, within its limit."""
    rows = (line.split() for line in Path("/proc/meminfo").read_text().splitlines())
    known = {row[0].rstrip(":"): int(row[1]) * 1024 for row in rows if len(row) > 1}
    total, free = known["MemTotal"], known.get("MemAvailable", known["MemFree"])
    group = Path("/sys/fs/cgroup")
    try:
        limit = (group / "memory.max").read_text().strip()
        if limit.isdigit() and int(limit) < total:
            used = int((group / "memory.current").read_text())
            return int(limit), max(0, min(free, int(limit) - used))
    except (OSError, ValueError):
        pass  # no cgroup of its own
    return total, free


def gpus() -> Iterator[Finding]:
    """Check the NVIDIA GPUs, by the names that the driver gives, and which installed packages can use them."""
    names, why = cuda_devices()
    if not names:
        yield Finding("machine", "GPU", "missing", f"{why}: the processor renders and learns")
        return
    yield Finding("machine", "GPU", "ok", ", ".join(names))
    for package, question in ASKED.items():
        found = installed_version(package)
        if found is None:
            continue
        if found.endswith("+cpu"):
            advice = "pip install torch from an index with CUDA: https://pytorch.org/get-started/locally"
            yield Finding("machine", f"GPU, {package}", "poor", f"{found} is built without CUDA", advice)
        elif ask(question):
            yield Finding("machine", f"GPU, {package}", "ok", f"{found} uses it")
        else:
            detail = f"{found} says that it cannot use it"
            yield Finding(
                "machine", f"GPU, {package}", "poor", detail, "bring the driver up to date: nvidia-smi says what it is"
            )


def cuda_devices() -> tuple[list[str], str]:
    """Names of the GPUs with their memory, from the driver itself; and the reason where there are none."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return [], "no NVIDIA driver"
    count = ctypes.c_int()
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0:
        return [], "the NVIDIA driver finds no GPU"
    found = []
    for number in range(count.value):
        device, name, size = ctypes.c_int(), ctypes.create_string_buffer(100), ctypes.c_size_t()
        driver.cuDeviceGet(ctypes.byref(device), number)
        driver.cuDeviceGetName(name, len(name), device)
        driver.cuDeviceTotalMem_v2(ctypes.byref(size), device)
        found.append(f"{name.value.decode(errors='replace')} with {in_bytes(size.value)}")
    return found, "the NVIDIA driver finds no GPU"


def ask(question: str) -> bool:
    """Whether a Python program, run in a process of its own, prints True."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", question], capture_output=True, text=True, timeout=ASK_S, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0 and done.stdout.split()[-1:] == ["True"]


def shared_memory() -> Finding:
    """Check the shared memory, through which workers of a DataLoader pass on their batches."""
    if not SHARED.is_dir():
        return Finding("machine", "shared memory", "poor", f"no {SHARED}: workers of PyTorch's DataLoader need it")
    free = shutil.disk_usage(SHARED).free
    if free >= LEAST_SHARED:
        return Finding("machine", "shared memory", "ok", f"{in_bytes(free)} free in {SHARED}")
    detail = f"{in_bytes(free)} free in {SHARED}: little for the batches of several workers of a DataLoader"
    return Finding("machine", "shared memory", "poor", detail, "in a container: docker run --shm-size=2g")


def temporary() -> Finding:
    """Check the folder of temporary files, in which runs keep what their processes exchange."""
    folder = Path(tempfile.gettempdir())
    chosen = os.environ.get("TMPDIR")
    if chosen and Path(chosen).absolute() != folder:
        detail = f"TMPDIR = {chosen} cannot be written to; {folder} is used instead"
        return Finding("machine", "temporary files", "broken", detail, "let TMPDIR name a folder, or unset it")
    free = shutil.disk_usage(folder).free
    little = free < LEAST_TEMPORARY
    advice = "let TMPDIR name a folder with more room" if little else ""
    return Finding(
        "machine", "temporary files", "poor" if little else "ok", f"{in_bytes(free)} free in {folder}", advice
    )


def look_at_containment() -> Iterator[Finding]:
    """Check what can keep methods and untrusted programs from data that they must not see."""
    if can_hide():
        yield Finding(
            "running", "hidden truth", "ok", "by Landlock: methods cannot open splits; results say `contained`"
        )
    else:
        detail = "no Landlock in this kernel, which Linux has from 5.13 on: results do not say `contained`"
        yield Finding("running", "hidden truth", "missing", detail)
    try:
        done = subprocess.run([sys.executable, "-I", "-S", "-c", ISOLATED], capture_output=True, check=False)
    except OSError as error:
        yield broken_by("running", "no network", error)
        return
    alone = done.returncode == 0
    detail = "a board can take the network from what it reads" if alone else "no network namespaces for this user"
    advice = "" if alone else "for a board that takes submissions: sysctl kernel.unprivileged_userns_clone=1"
    yield Finding("running", "no network", "ok" if alone else "missing", detail, advice)
    tools = [name for name in ("podman", "docker") if shutil.which(name)]
    detail = ", ".join(tools) or "neither podman nor docker: `oysterbench systems container` needs one of them"
    yield Finding("running", "containers", "ok" if tools else "missing", detail)
