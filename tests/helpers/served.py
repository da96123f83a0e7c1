"""A hidden split with truth that nobody rendered, a server of submissions for it, and answers to send.

python served.py FOLDER PORT    serves what `lay` has laid out there
"""

from __future__ import annotations

import http.client
import io
import json
import os
import socket
import subprocess
import sys
import zipfile
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import transform
from oysterbench.core.ros import EPOCH_NS, TF_STATIC
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.sensors.camera_messages import camera_topics, colour_message, layer_message
from oysterbench.sensors.imu import IMU
from oysterbench.sequence.read import CALIBRATION, METADATA, OYSTERS, STEERING
from oysterbench.sequence.truth import TRANSFORMS, TRUTH, TRUTH_TYPES, truth_message
from oysterbench.sequence.write import SequenceWriter
from oysterbench_leaderboard.submissions.database import Database
from oysterbench_leaderboard.submissions.settings import load_settings
from oysterbench_leaderboard.submissions.tokens import issue
from tests.helpers.paths import ROOT
from tests.helpers.waiting import until

NAMES = ("pool-01", "pool-02")
EPOCH_NS = EPOCH_NS
CAMERA = {
    "width": 64,
    "height": 48,
    "rate_hz": 2.0,
    "matrix": [[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]],
    "distortion_model": "plumb_bob",
    "distortion": [0.0, 0.0, 0.0, 0.0],
    "T_base_cam": np.eye(4).tolist(),
}
IMAGES = 3

RIG = """
name = "pool"
summary = "a small camera and an inertial unit"
truth_rate_hz = 50.0
[imu]
rate_hz = 100.0
gyro_noise_density = 1e-4
gyro_random_walk = 1e-5
gyro_turn_on = 1e-3
accel_noise_density = 1e-3
accel_random_walk = 1e-4
accel_turn_on = 1e-2
[[camera]]
name = "cam"
width = 64
height = 48
hfov_deg = 69.0
rate_hz = 2.0
layer_rate_hz = 2.0
"""

SPLIT = """
name = "{name}"
version = "1.0"
track = "{track}"
seed = 5
rig = "rig.toml"
summary = "a pool that is not there"
hidden = {hidden}
[defaults]
duration_s = 20.0
[defaults.reef]
size_m = 12.0
depth_m = 4.0
relief_rms_m = 0.05
oysters = 60
[defaults.water]
jerlov = "1C"
[defaults.light]
sun_elevation_deg = 50.0
sun_azimuth_deg = 200.0
[defaults.path]
kind = "loop"
radius_m = 1.0
speed_m_s = 0.3
ramp_s = 1.0
altitude_m = 0.9
[[sequence]]
name = "pool-01"
[[sequence]]
name = "pool-02"
"""

TASK = """
[steering]
yaw_deg = [20.0, 0.0, -20.0]
pitch_deg = [-15.0, 0.0, 15.0]
altitude_m = [0.5, 1.4]
"""
"""What a split of the track steering has besides."""

FAST: dict[str, Any] = {"per_day": 1000, "per_split": 1000}
"""SubmissionSettings of the tests' servers, unless they ask for others."""


def path(number: int) -> Trajectory:
    """The truth of a sequence: a winding loop at 10 Hz, whose numbers are like no others."""
    rng = stream(20261120, b"", "pool", number)
    t = np.arange(200) / 10
    phases = rng.uniform(0, 6, 6)
    positions = np.column_stack([4 * np.cos(t / 3 + phases[0]), 3 * np.sin(t / 3 + phases[1]), -3 + 0.2 * np.sin(t)])
    positions += 0.1234567 * np.sin(np.outer(t, [1.1, 1.3, 1.7]) + phases[2:5])
    attitude = Rotation.from_euler("zyx", np.column_stack([t / 3, 0.1 * np.sin(t), 0.1 * np.cos(t + phases[5])]))
    return Trajectory(EPOCH_NS + np.round(t * 1e9).astype(np.int64), positions, attitude.as_quat())


def estimate(number: int, sigma_m: float = 0.02, case: int = 0) -> Trajectory:
    """The truth of a sequence with errors."""
    true = path(number)
    noise = stream(1, b"", "estimate", number, case).normal(0, sigma_m, true.positions.shape)
    return Trajectory(true.stamps_ns, true.positions + noise, true.quaternions)


def tum(trajectory: Trajectory, folder: Path) -> bytes:
    """As a TUM file."""
    write_tum(folder / "x.tum", trajectory)
    return (folder / "x.tum").read_bytes()


def answers(folder: Path, case: int = 0, sigma_m: float = 0.02) -> bytes:
    """A zip archive with an estimate for each sequence."""
    return zipped({f"{name}.tum": tum(estimate(k, sigma_m, case), folder) for k, name in enumerate(NAMES)})


def zipped(files: dict[str, bytes], **entry: Any) -> bytes:
    """A zip archive of files."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            for key, value in entry.items():
                setattr(info, key, value)
            archive.writestr(info, data)
    return out.getvalue()


def classes(sequence: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Classes and instances (48, 64) of an image: two oysters."""
    instances = np.zeros((48, 64), dtype=np.uint16)
    instances[10 + k : 24 + k, 8 + 3 * sequence : 24] = 7
    instances[30:40, 40:52] = 9
    return np.where(instances > 0, 2, 1).astype(np.uint8), instances


def image_names(sequence: int) -> list[str]:
    """Of a sequence, as they are to be answered."""
    return [f"{NAMES[sequence]}/cam/{EPOCH_NS + k * 500_000_000}" for k in range(IMAGES)]


def steered(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Classes (IMAGES, 2) of the expert at the images of a sequence, and the worth (IMAGES, 3, 3) of each pair."""
    worth = stream(20261121, b"", "pool", "worth", number).uniform(0, 9, (IMAGES, 3, 3))
    best = worth.reshape(IMAGES, -1).argmax(axis=1)
    return np.column_stack([best // 3, best % 3]), worth


def steering_table(number: int) -> bytes:
    """The truth of a sequence about steering, as it is attached to its file."""
    keys = [f"value_{i}_{j}" for i in range(3) for j in range(3)]
    lines = [",".join(["stamp_ns", "yaw", "pitch", "heading_rad", "pitch_rad", "depth_m", "altitude_m", *keys])]
    for k, (named, worth) in enumerate(zip(*steered(number), strict=True)):
        values = [EPOCH_NS + k * 500_000_000, *named.tolist(), 0.1, 0.0, 3.0, 0.9, *worth.ravel().tolist()]
        lines.append(",".join(map(str, values)))
    return "\n".join(lines).encode() + b"\n"


def write_sequence(file: Path, number: int, split: str, digest: str) -> None:
    """A sequence with truth and a few images, as if it had been rendered."""
    calibration = {
        "imu": {
            "rate_hz": 100.0,
            "gyro_noise_density": 1e-4,
            "gyro_random_walk": 1e-5,
            "gyro_turn_on": 1e-3,
            "accel_noise_density": 1e-3,
            "accel_random_walk": 1e-4,
            "accel_turn_on": 1e-2,
            "T_base_imu": transform(np.eye(3), [0.0, 0.0, 0.0]).tolist(),
            "gravity": 9.80665,
        },
        "cameras": {"cam": CAMERA},
    }
    cameras = camera_topics("cam", ("class", "instance", "depth"))
    about = {"sequence": NAMES[number], "split": split, "split_version": "1.0", "digest": digest}
    true = path(number)
    with open(file, "wb") as output:
        writer = SequenceWriter(output, {TF_STATIC: TRANSFORMS, "/imu": IMU, TRUTH: TRUTH_TYPES[TRUTH], **cameras})
        writer.metadata(METADATA, about)
        writer.attachment(CALIBRATION, "application/json", json.dumps(calibration).encode())
        oysters = b"id,state,height_m,x,y,z\n7,live,0.08,0.5,0.1,-3.0\n9,live,0.1,0.8,-0.2,-3.0\n"
        writer.attachment(OYSTERS, "text/csv", oysters)
        writer.attachment(STEERING, "text/csv", steering_table(number))
        for i, stamp in enumerate(true.stamps_ns.tolist()):
            pose = (true.positions[i], true.quaternions[i])
            writer.write(truth_message(stamp, *pose, np.zeros(3), np.zeros(3)))
        writer.section()
        for k in range(IMAGES):
            stamp = EPOCH_NS + k * 500_000_000
            named, numbered = classes(number, k)
            layers = {"class": named, "instance": numbered, "depth": np.full((48, 64), 1.0, dtype=np.float32)}
            writer.write(colour_message(stamp, "cam", np.full((48, 64, 3), 90, dtype=np.uint8), 95, "png"))
            for name, values in layers.items():
                writer.write(layer_message(stamp, "cam", name, values))
        writer.finish()


def lay_split(folder: Path, name: str = "pool-test", track: str = "slam", hidden: bool = True) -> tuple[Path, Path]:
    """Recipe and truth of a split."""
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import digest

    truth = folder / f"{name}-truth"
    truth.mkdir(parents=True)
    (folder / "rig.toml").write_text(RIG)
    recipe = folder / f"{name}.toml"
    text = SPLIT.format(name=name, track=track, hidden=str(hidden).lower())
    recipe.write_text(text + (TASK if track == "steering" else ""))
    made_by = digest(load_split(str(recipe)))
    for k, sequence in enumerate(NAMES):
        write_sequence(truth / f"{sequence}.mcap", k, name, made_by)
    return recipe, truth


def lay(folder: Path, **settings: Any) -> dict[str, str]:
    """Lay out a server: four splits, and two teams with a token each, which are returned."""
    splits = folder / "splits"
    for name, track, hidden in (
        ("pool-test", "slam", True),
        ("pool-masks", "segmentation", True),
        ("pool-val", "slam", False),
        ("pool-steer", "steering", True),
    ):
        lay_split(splits, name, track, hidden)
    private = folder / "private"
    private.mkdir()
    lines = [f"{key} = {value!r}" for key, value in {**FAST, **settings}.items()]
    (private / "settings.toml").write_text("\n".join(lines))
    database = Database(load_settings(private))
    tokens = {team: issue(database, team) for team in ("reef lab", "others")}
    database.close()
    return tokens


def make_service(folder: Path, **changes: Any) -> Any:
    """The service that was laid out there."""
    from oysterbench_leaderboard.store import RecordStore
    from oysterbench_leaderboard.submissions.catalogue import Catalogue, serve_split
    from oysterbench_leaderboard.submissions.service import Service

    splits, private = folder / "splits", folder / "private"
    names = sorted(path.stem for path in splits.glob("pool-*.toml"))
    served = [serve_split(str(splits / f"{n}.toml"), splits / f"{n}-truth", private / "catalogue") for n in names]
    return Service(load_settings(private, **changes), Catalogue(served), RecordStore(folder / "board"))


def drain(service: Any) -> int:
    """Score all that waits; how many attempts that took."""
    from oysterbench_leaderboard.submissions import queue
    from oysterbench_leaderboard.submissions.database import find, log, submissions

    def attempts() -> int:
        with service.database.reading() as connection:
            return sum(event["what"] == "running" for event in log(connection, limit=100_000))

    def enough() -> bool:
        with service.database.reading() as connection:
            return not find(connection, submissions.c.state.in_(("queued", "running")))

    before = attempts()
    with service.database.alone() as connection:
        queue.dispatch(service, connection, queue.in_threads(1), enough)
    return attempts() - before


def serve(folder: Path, port: int) -> None:
    """Until it is killed."""
    import uvicorn

    from oysterbench.hub.connections import server_settings
    from oysterbench_leaderboard.index import open_index
    from oysterbench_leaderboard.site.render import server_links
    from oysterbench_leaderboard.site.server import application
    from oysterbench_leaderboard.site.site import Site
    from oysterbench_leaderboard.submissions.web import Submissions

    service = make_service(folder)
    index = open_index(service.store, str(folder / "index.sqlite"))
    service.changed = index.refresh
    submissions = Submissions(service, server_links())
    app = application(Site(index, form=submissions.form), more=submissions.routes())
    submissions.attach(app)
    uvicorn.run(**server_settings(app, "127.0.0.1", port, "on"))


def free_port() -> int:
    """A port that nobody listens on."""
    with closing(socket.socket()) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Server:
    """A server in a process of its own, and requests to it. seen: all that was answered."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, free_port()
        self.process: subprocess.Popen[bytes] | None = None
        self.seen = bytearray()

    def begin(self) -> subprocess.Popen[bytes]:
        """A process that will answer in a moment."""
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with open(self.folder / "server.log", "ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.helpers.served", str(self.folder), str(self.port)],
                cwd=ROOT,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env=environment,
            )
        return self.process

    def start(self) -> None:
        """Returns when it answers."""
        process = self.begin()
        until(lambda: self.alive() or process.poll() is not None)
        assert process.poll() is None, (self.folder / "server.log").read_text()

    def alive(self) -> bool:
        """Whether it answers."""
        try:
            return self.ask("GET", "/api/submissions/splits")[0] == 200
        except OSError:
            return False

    def ask(
        self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None, token: str = ""
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of an answer."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)) as connection:
            bearer = {"Authorization": f"Bearer {token}"} if token else {}
            connection.request(method, path, body, {**bearer, **(headers or {})})
            answer = connection.getresponse()
            data = answer.read()
            self.seen += repr(answer.getheaders()).encode() + data
            return answer.status, {k.lower(): v for k, v in answer.getheaders()}, data

    def send(self, token: str, body: bytes, kind: str = "application/zip", **asked: str) -> tuple[int, dict[str, Any]]:
        """Send a submission: status, and what was answered."""
        from urllib.parse import urlencode

        query = urlencode({"method": "carp", "split": "pool-test", **asked})
        found = self.ask("POST", f"/api/submissions?{query}", body, {"Content-Type": kind}, token)
        return found[0], json.loads(found[2])

    def wait(self, token: str, id: str) -> dict[str, Any]:
        """A submission when it is scored."""
        found: dict[str, Any] = {}

        def scored() -> bool:
            found.update(json.loads(self.ask("GET", f"/api/submissions/{id}", token=token)[2]))
            return found["state"] not in ("queued", "running")

        until(scored)
        return found

    def stop(self) -> None:
        """End it in good order."""
        if self.process is not None:
            self.process.terminate()
            self.process.wait(60)


@contextmanager
def running(folder: Path) -> Any:
    """A server, stopped at the end."""
    server = Server(folder)
    server.start()
    try:
        yield server
    finally:
        server.stop()


if __name__ == "__main__":
    serve(Path(sys.argv[1]), int(sys.argv[2]))
