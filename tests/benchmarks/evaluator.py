"""How long a score takes beside evo's APE and RPE on the same files: `python tests/benchmarks/evaluator.py`.

One million poses against one million, by default. Every tool runs in a process of its own, one after the other, and
reads the same two TUM files, which is timed apart. Ours gives every metric; evo gives absolute and relative errors
(over 1 frame, all pairs) of translation and rotation angle.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.streams import stream

RATE_HZ = 200


def write_files(folder: Path, poses: int) -> None:
    """A survey, and an estimate of it that drifts, wavers and has stamps of its own."""
    rng = stream(5, b"", "benchmark")
    t = np.arange(poses) / RATE_HZ
    positions = np.column_stack([40 * np.cos(t / 30) + 0.01 * t, 30 * np.sin(t / 30), -3 + 0.2 * np.sin(t)])
    attitude = Rotation.from_euler("zyx", np.column_stack([t / 30, 0.1 * np.sin(t), 0.1 * np.cos(t)]))
    walk = np.cumsum(rng.normal(0, 1e-3, (poses, 3)), axis=0) + rng.normal(0, 0.01, (poses, 3))
    waver = Rotation.from_rotvec(rng.normal(0, 0.01, (poses, 3)))
    for name, shift_s, xyz, turn in (
        ("truth", 0.0, positions, attitude),
        ("estimate", 0.001, positions + walk, attitude * waver),
    ):
        table = np.column_stack([1e5 + t + shift_s, xyz, turn.as_quat()])
        np.savetxt(folder / f"{name}.tum", table, fmt=["%.6f"] + ["%.9f"] * 7)


def run_ours(folder: Path) -> dict[str, float]:
    """Read and score; seconds of each."""
    from oysterbench.core.trajectory import read_trajectory
    from oysterbench.evaluate.slam.scoring import score

    clock = Clock()
    truth, estimate = (read_trajectory(folder / f"{name}.tum") for name in ("truth", "estimate"))
    clock.lap("read")
    result = score(truth, estimate)
    clock.lap("score")
    return {**clock.seconds, "ate_rmse_m": result.metrics["ate_rmse_m"], "metrics": len(result.metrics)}


def run_evo(folder: Path) -> dict[str, float]:
    """Read, associate, align and take APE and RPE, by evo's own functions; seconds of each."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from evo.core import metrics, sync
        from evo.tools import file_interface

    clock = Clock()
    truth, estimate = (
        file_interface.read_tum_trajectory_file(folder / f"{name}.tum") for name in ("truth", "estimate")
    )
    clock.lap("read")
    pair = sync.associate_trajectories(truth, estimate)
    pair[1].align(pair[0])
    taken = 0
    errors = {}
    for relation in (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg):
        for metric in (metrics.APE(relation), metrics.RPE(relation, 1, metrics.Unit.frames, all_pairs=True)):
            metric.process_data(pair)
            errors[metric.__class__.__name__, relation.name] = metric.get_all_statistics()["rmse"]
            taken += 1
    clock.lap("score")
    return {**clock.seconds, "ate_rmse_m": errors["APE", "translation_part"], "metrics": taken}


class Clock:
    """Processor and wall seconds of what lies between two laps, and the highest memory so far."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._cpu, self._wall = time.process_time(), time.perf_counter()

    def lap(self, name: str) -> None:
        """End a lap."""
        cpu, wall = time.process_time(), time.perf_counter()
        self.seconds |= {f"{name}_cpu": cpu - self._cpu, f"{name}_wall": wall - self._wall}
        per_mib = 1024 if sys.platform != "darwin" else 1024**2
        self.seconds[f"{name}_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / per_mib
        self._cpu, self._wall = time.process_time(), time.perf_counter()


TOOLS = {"oysterbench": run_ours, "evo": run_evo}


def main() -> None:
    """Print the table; exit 1 where a promise is broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=1_000_000)
    parser.add_argument("--tool", choices=TOOLS, help="run one of them on --folder, and print its numbers as JSON")
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    if options.tool:
        print(json.dumps(TOOLS[options.tool](options.folder)))
        return
    with tempfile.TemporaryDirectory() as name:
        write_files(Path(name), options.poses)
        rows = {}
        for tool in TOOLS:
            command = [sys.executable, __file__, "--tool", tool, "--folder", name]
            rows[tool] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    print(f"{options.poses} poses against {options.poses}; seconds of processor time (by the clock), peak memory")
    print(f"{'':12s} {'read':>16s} {'score':>16s} {'memory':>10s} {'metrics':>8s} {'ATE':>12s}")
    for tool, row in rows.items():
        times = [f"{row[f'{lap}_cpu']:.2f} ({row[f'{lap}_wall']:.2f})" for lap in ("read", "score")]
        print(
            f"{tool:12s} {times[0]:>16s} {times[1]:>16s} {row['score_mib']:>6.0f} MiB {row['metrics']:>8.0f} "
            f"{row['ate_rmse_m']:>10.4f} m"
        )
    ours, evo = rows["oysterbench"], rows["evo"]
    ratio = evo["score_cpu"] / ours["score_cpu"]
    kept = {
        f"{ratio:.1f} times as fast as evo's APE and RPE (10 promised)": ratio >= 10,
        f"{ours['score_cpu']:.2f} s of processor time (5 promised)": ours["score_cpu"] <= 5,
        f"{ours['score_mib'] / 1024:.2f} GiB (2 promised)": ours["score_mib"] <= 2048,
    }
    for promise, holds in kept.items():
        print(f"{'kept  ' if holds else 'BROKEN'} {promise}")
    sys.exit(0 if all(kept.values()) else 1)


if __name__ == "__main__":
    main()
