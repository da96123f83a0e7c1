"""A small folder in EuRoC layout, as others make them."""

from __future__ import annotations

import shutil

import cv2
import numpy as np

import oysterbench

CAMERA = """sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.2,
         0.0, 0.0, 1.0, 0.3, 0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [32, 24]
camera_model: pinhole
intrinsics: [25.0, 25.0, 15.5, 11.5]
distortion_model: radial-tangential
distortion_coefficients: [0.1, 0.0, 0.0, 0.0]
"""
IMU = """sensor_type: imu
rate_hz: 200
gyroscope_noise_density: 1.0e-4
gyroscope_random_walk: 1.0e-5
accelerometer_noise_density: 1.0e-3
accelerometer_random_walk: 1.0e-3
"""
FRAMES = [10**18 + k * 50_000_000 for k in range(3)]
SAMPLES = [10**18 + k * 5_000_000 for k in range(20)]


class Folder:
    """A folder whose files can be changed: `change` replaces a text in one of them."""

    def __init__(self, path) -> None:
        self.path, self.root = path, path / "mav0"
        (self.root / "cam0" / "data").mkdir(parents=True)
        (self.root / "imu0").mkdir()
        for stamp in FRAMES:
            cv2.imwrite(str(self.root / "cam0" / "data" / f"{stamp}.png"), np.zeros((24, 32), np.uint8))
        rows = "".join(f"{stamp},0,0,0,0,0,{k}.5\n" for k, stamp in enumerate(SAMPLES))
        self.write("cam0/sensor.yaml", CAMERA)
        self.write("cam0/data.csv", "#timestamp [ns],filename\n" + "".join(f"{s},{s}.png\n" for s in FRAMES))
        self.write("imu0/sensor.yaml", IMU)
        self.write("imu0/data.csv", f"#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n{rows}")

    def write(self, file: str, text: str, encoding: str = "utf-8") -> None:
        (self.root / file).parent.mkdir(exist_ok=True)
        (self.root / file).write_text(text, encoding=encoding)

    def change(self, file: str, old: str, new: str) -> None:
        text = (self.root / file).read_text()
        assert old in text
        self.write(file, text.replace(old, new))

    def add_camera(self, name: str) -> None:
        shutil.copytree(self.root / "cam0", self.root / name)

    def read(self) -> list[int]:
        return [item.stamp_ns for item in oysterbench.open(self.path).stream()]
