"""A user with trained weights, who has a hub, and commands run as in a shell with nothing set."""

from __future__ import annotations

import hashlib

import torch

from oysterbench_baselines.unet.training import train
from tests.helpers.command import run_bare
from tests.helpers.small_trainings import SMALL, small_set


class Place:
    """A user with a training of a unet, who has a hub; and commands, run as in a shell with nothing set."""

    def __init__(self, folder):
        self.folder, self.home, self.tree = folder, folder / "home", folder / "hub"
        self.weights = self.home / "models" / "unet_small.pt"
        self.learnt = small_set(folder / "shells", {"one": ("train", 4)})
        self.unseen = small_set(folder / "unseen", {"two": ("val", 2)}, first=50)
        train(self.learnt, self.weights, SMALL, 3, torch.device("cpu"))
        self.digest = hashlib.sha256(self.weights.read_bytes()).hexdigest()
        self.public = self.run("keygen", folder / "key.pem").stdout.strip()

    def run(self, *arguments, code=0, home=None, **environment):
        return run_bare(*arguments, home=home or self.home, code=code, **environment)

    def publish(self, *arguments, tree=None, **options):
        words = ("publish-model", "unet_small", tree or self.tree, "--key", self.folder / "key.pem")
        return self.run(*words, *arguments, **options)
