"""Ping times of a log from the arrival times of its messages: pings are regular, message delays are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PingClockSettings:
    """Regularity of pings and of the delays of their messages."""

    jitter_s: float = 0.06  # 1 sigma of a message's delay about its mean, before any is seen
    memory: float = 20.0  # messages, over which it is estimated
    floor_s: float = 2e-4  # and not below this
    period_walk_s: float = 2e-4  # s, from ping to ping: at 2 to 15 Hz over 50 m, 10 cm of altitude change it by 0.9 ms
    gate: float = 4.0  # sigmas, beyond which messages were lost in between


class PingClock:
    """A Kalman filter of the time of the last ping and of the period, by the stamps of arrival (Olson 2010, IROS, on
    why a steady clock behind a jittery link can be recovered)."""

    def __init__(self, settings: PingClockSettings) -> None:
        self.settings = settings
        self._variance = settings.jitter_s**2  # s^2, of a delay
        self._origin_ns: int | None = None
        self._state = np.zeros(2)  # s: time of the last ping since the first, period; zero before there is one
        self._covariance = np.diag([self._variance, 0.0])

    def late(self, stamp_ns: int) -> tuple[float, float]:
        """Delay (s) of a message relative to the mean, and its 1 sigma; to be called once per message, in order."""
        settings = self.settings
        if self._origin_ns is None:
            self._origin_ns = stamp_ns
            return 0.0, settings.jitter_s
        arrived = (stamp_ns - self._origin_ns) * 1e-9
        if self._state[1] == 0.0:  # two stamps make a period
            self._state = np.array([arrived, arrived])
            self._covariance = self._variance * np.array([[1.0, 1.0], [1.0, 2.0]])
            return 0.0, settings.jitter_s
        pings = 1
        period = self._state[1]
        ahead = arrived - self._state[0] - period
        spread = np.sqrt(self._covariance[0, 0] + self._variance)
        if ahead > settings.gate * spread:
            pings += round(ahead / period)
        move = np.array([[1.0, pings], [0.0, 1.0]])
        self._state = move @ self._state
        walk = settings.period_walk_s**2 * pings
        self._covariance = move @ self._covariance @ move.T + walk * np.array([[0.25, 0.5], [0.5, 1.0]])
        innovation = arrived - self._state[0]
        total = self._covariance[0, 0] + self._variance
        gain = self._covariance[:, 0] / total
        self._state = self._state + gain * innovation
        self._covariance = self._covariance - np.outer(gain, gain) * total
        seen = max(innovation**2 - self._covariance[0, 0], settings.floor_s**2)
        self._variance += (seen - self._variance) / settings.memory
        return float(arrived - self._state[0]), float(np.sqrt(self._covariance[0, 0]))
