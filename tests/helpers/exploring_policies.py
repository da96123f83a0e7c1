"""Policies for the tests: one that reads the expert's classes off the picture, and ones that do not do as agreed."""

from __future__ import annotations

import os
import signal
import time

import numpy as np

from oysterbench.methods.steering import Steering


class Reader:
    """Reads what `exploring_made.picture` wrote."""

    name, track = "reader", "steering"

    def run(self, views):
        for view in views:
            yaw, pitch = (round((int(value) - 20) / 30) for value in view.pixels[12, 16, :2])
            yield Steering(view.name, yaw, pitch)


class Unsure(Reader):
    """Knows the classes, with half its probability."""

    name = "unsure"

    def run(self, views):
        for command in super().run(views):
            yield Steering(
                command.name,
                yaw_probability=np.eye(7)[command.yaw] + 1 / 7,
                pitch_probability=np.eye(7)[command.pitch] + 1 / 7,
            )


class Threads:
    """Fails with the number of threads that it is to start."""

    name, track = "threads", "steering"

    def run(self, views):
        raise RuntimeError(f"threads: {os.environ.get('OMP_NUM_THREADS')}")


class Ahead:
    """Takes all views before it commands."""

    name, track = "ahead", "steering"

    def run(self, views):
        for view in list(views):
            yield Steering(view.name, 3, 3)


class Wrong(Ahead):
    """Commands at another view."""

    name = "wrong"

    def run(self, views):
        for _ in views:
            yield Steering("another", 3, 3)


class Short(Ahead):
    """Stops after the first view."""

    name = "short"

    def run(self, views):
        for view in views:
            yield Steering(view.name, 3, 3)
            return


class Broken(Ahead):
    """Raises."""

    name = "broken"

    def run(self, views):
        for _ in views:
            raise ValueError("no such\nweight")
        yield


class Few(Ahead):
    """Has six classes of yaw."""

    name = "few"

    def run(self, views):
        for view in views:
            yield Steering(view.name, yaw_probability=np.ones(6), pitch=3)


class NotNumbers(Ahead):
    """Gives a NaN."""

    name = "nan"

    def run(self, views):
        for view in views:
            yield Steering(view.name, 3, pitch_probability=np.full(7, np.nan))


class Negative(Ahead):
    """Gives a probability below 0."""

    name = "negative"

    def run(self, views):
        for view in views:
            yield Steering(view.name, 3, pitch_probability=np.array([-1.0, 1, 1, 1, 1, 1, 1]))


class Outside(Ahead):
    """Commands a class that is not there."""

    name = "outside"

    def run(self, views):
        for view in views:
            yield Steering(view.name, 7, 0)


class WithOption(Reader):
    """Has an option."""

    name = "with-option"

    def __init__(self, gain: float = 1.0) -> None:
        self.gain = gain

    def as_dict(self):
        return {"gain": self.gain}


class Hanging(Ahead):
    """Never commands."""

    name = "hanging"

    def run(self, views):
        for _ in views:
            time.sleep(600)
        yield


class Killed(Ahead):
    """Is killed, as by the kernel when memory runs out."""

    name = "killed"

    def run(self, views):
        for _ in views:
            os.kill(os.getpid(), signal.SIGKILL)
        yield


class Busy(Ahead):
    """Computes for a third of a second before each command."""

    name = "busy"

    def run(self, views):
        for view in views:
            end = time.process_time() + 0.33
            while time.process_time() < end:
                pass
            yield Steering(view.name, 3, 3)
