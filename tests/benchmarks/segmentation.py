"""How long masks take to score: `python tests/benchmarks/segmentation.py`.

1000 images of 640 x 480, by default: true masks as PNG, and probability maps of 8 bits as PNG, or of float32 as .npy.
The whole of `oysterbench eval --track segmentation --truth DIR --estimate DIR` is timed, in a process of its own:
reading, scoring, tables. CPU seconds, as a busy machine stretches all others.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from oysterbench.core.streams import stream

HEIGHT, WIDTH = 480, 640


def write_images(folder: Path, count: int, form: str) -> None:
    """Blobs, some 30 % of the image, and what a network may say of them. 40 different images, under many names."""
    rng = stream(11, b"", "benchmark", "segmentation")
    made = []
    for _ in range(min(count, 40)):
        rough = cv2.resize(rng.normal(size=(24, 32)).astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        noise = cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH)).astype(np.float32), (0, 0), 2)
        made.append((rough > 0.5, 1 / (1 + np.exp(-4 * (rough - 0.5 + noise)))))
    for name in ("truth", "estimate"):
        (folder / name).mkdir()
    for k in range(count):
        mask, probability = made[k % len(made)]
        cv2.imwrite(str(folder / "truth" / f"{k:05}.png"), mask.astype(np.uint8) * 255)
        if form == "png":
            cv2.imwrite(str(folder / "estimate" / f"{k:05}.png"), np.round(255 * probability).astype(np.uint8))
        else:
            np.save(folder / "estimate" / f"{k:05}.npy", probability.astype(np.float32))


def main() -> None:
    """Write, score, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=1000)
    parser.add_argument("--form", choices=("png", "npy"), default="png")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_images(folder, options.images, options.form)
        command = [str(Path(sys.executable).with_name("oysterbench")), "eval", "--track", "segmentation"]
        command += ["--truth", str(folder / "truth"), "--estimate", str(folder / "estimate")]
        begin = time.perf_counter()
        subprocess.run(command, check=True)
        wall = time.perf_counter() - begin
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        print(
            f"{options.images} images of {WIDTH} x {HEIGHT}: {used.ru_utime + used.ru_stime:.1f} s of CPU, "
            f"{wall:.1f} s by the clock, {used.ru_maxrss / 1024:.0f} MiB at most"
        )


if __name__ == "__main__":
    main()
