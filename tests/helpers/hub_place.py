"""Where commands of the hub are typed: a home, a key, files, a published tree."""

from __future__ import annotations

from oysterbench.recipe import load_split
from oysterbench.simulation.generate import digest
from tests.helpers.command import run_bare
from tests.helpers.hand_made_dive import SENSORS
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT
from tests.helpers.trees import FACTS, TEXTS, write_sequence


class Place:
    """A home, a recipe whose files are made by hand, a key and a published tree."""

    def __init__(self, folder):
        self.folder, self.home, self.tree, self.data = (folder, folder / "home", folder / "hub", folder / "data")
        (folder / "rig.toml").write_text(TINY_RIG.replace("cam_front", "cam_left") + SENSORS)
        self.recipe = folder / "tiny.toml"
        self.recipe.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "rig.toml"'))
        self.write(self.data, digest(load_split(str(self.recipe))))
        self.public = self.run("keygen", folder / "key.pem").stdout.strip()
        self.run("publish", self.recipe, self.tree, "--key", folder / "key.pem", "--data", self.data)
        self.whole = (self.data / "tiny-01.mcap").read_bytes()

    def write(self, folder, made_with):
        """The file of the recipe's sequence, by the digest that it is said to be made with."""
        known, texts = dict(FACTS), dict(TEXTS)
        FACTS.update(split="tiny", version="1.0")
        TEXTS.update(load_split(str(self.recipe)).texts)
        try:
            write_sequence(folder / "tiny-01.mcap", "tiny-01", 0.5, made_with)
        finally:
            FACTS.update(known)
            TEXTS.update(texts)

    def run(self, *arguments, code=0, home=None, **environment):
        """Type a command; its exit status is `code`."""
        return run_bare(*arguments, home=home or self.home, code=code, **environment)
