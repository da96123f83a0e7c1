"""The expert's command at each image of a sequence: labels for behavioural cloning."""

from __future__ import annotations

import numpy as np
import pandas as pd

from oysterbench.recipe import SteeringRecipe, count
from oysterbench.sensors.camera import shown
from oysterbench.simulation.sensor_simulation import sensor_kept, sensor_stamps
from oysterbench.simulation.simulated_sequence import SimulatedSequence
from oysterbench.simulation.steering.expert import Expert, best
from oysterbench.simulation.steering.observation import Observation
from oysterbench.simulation.steering.site import build_site, measure_state
from oysterbench.simulation.steering.vehicle import state_of


def steering_csv(simulated: SimulatedSequence, task: SteeringRecipe) -> bytes:
    """CSV of the table of `Sequence.steering`. The expert knows which oysters the images so far have shown; those that
    the camera lost have shown none, and have no label, and those that it repeated have shown what they repeat."""
    site = build_site(simulated, task)
    expert, observation = Expert(site), Observation(site)
    camera = site.camera
    n = count(simulated.recipe.duration_s, camera.rate_hz)
    kept = sensor_kept(simulated, camera, n)
    stamps, times = sensor_stamps(simulated, camera, n)[kept], (np.arange(n) / camera.rate_hz)[kept]
    seen_s = shown(simulated, camera)[kept] / camera.rate_hz
    renderer = simulated.renderers[camera.name]
    rows = []
    bodies, seen_from = simulated.bodies(times), simulated.bodies(seen_s)
    for stamp, body, time_s, there in zip(stamps.tolist(), bodies, seen_s.tolist(), seen_from, strict=True):
        T_map_cam = there @ site.mount
        depth, _, instances = renderer.truth(T_map_cam, time_s)
        observation.observe(T_map_cam, depth, instances)
        state = state_of(body[:3, 3], body[:3, :3])
        values = expert.values(state, observation.found)
        yaw, pitch = best(values)
        own = measure_state(site, state)
        row: dict[str, float] = {"stamp_ns": stamp, "yaw": yaw, "pitch": pitch}
        row |= {"heading_rad": own.heading, "pitch_rad": own.pitch, "depth_m": own.depth, "altitude_m": own.altitude}
        row |= {f"value_{y}_{p}": value for (y, p), value in np.ndenumerate(values)}
        rows.append(row)
    return pd.DataFrame(rows).to_csv(index=False, lineterminator="\n", float_format="%.10g").encode()
