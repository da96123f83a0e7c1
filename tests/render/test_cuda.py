"""What renders on a GPU: compiled for one wherever there is none, and its bytes where there is."""

import pytest
import warp as wp

from oysterbench.hub.canonical import sha256
from oysterbench.render.camera import MODULES
from oysterbench.render.target import start_warp
from oysterbench.simulation.generate import generate_split

ARCHITECTURE = 90
"""Compute capability 9.0: H100, H200."""


@pytest.mark.slow
def test_every_kernel_compiles_for_a_gpu_that_is_not_here(tmp_path):
    start_warp()
    for module in MODULES:
        made = wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=tmp_path, use_ptx=False)
        assert [path.suffix for path in made] == [".cubin"], module.__name__
        assert made[0].stat().st_size > 0


def test_a_gpu_makes_the_bytes_of_a_processor(tiny_split, tiny_file, tmp_path):
    start_warp()
    if not wp.is_cuda_available():
        pytest.skip("there is no CUDA device")
    files = generate_split(tiny_split, tmp_path, device="cuda")
    assert sha256(files["tiny-01"].read_bytes()) == sha256(tiny_file.read_bytes())
