"""A network that finds oysters: `python my_net.py` trains it, `oysterbench run my_net:MyNet` runs it."""

from pathlib import Path

import torch
from torch import nn
from torch.utils.data import DataLoader

import oysterbench
from oysterbench.methods.images import Segmentation

WEIGHTS = Path(__file__).with_name("my_net.pt")
STEPS = 250


def block(channels_in, channels_out, dilation):
    convolution = nn.Conv2d(channels_in, channels_out, 3, padding=dilation, dilation=dilation)
    return nn.Sequential(convolution, nn.GroupNorm(4, channels_out), nn.ReLU())


def network():
    parts = block(3, 16, 1), block(16, 16, 2), block(16, 24, 4), block(24, 24, 8), block(24, 24, 2)
    return nn.Sequential(*parts, nn.Conv2d(24, 1, 1))


def prepared(image):
    """Take every eighth pixel of an image (3, H, W) uint8, each channel with mean 0 and standard deviation 1."""
    small = image[:, ::8, ::8].float()
    return (small - small.mean(dim=(1, 2), keepdim=True)) / small.std(dim=(1, 2), keepdim=True)


def item(frame):
    oyster, asked = frame["oyster"][::8, ::8].float(), (~frame["ignore"][::8, ::8]).float()
    return prepared(frame["image"]), oyster, asked


def train():
    torch.manual_seed(0)
    torch.set_num_threads(1)  # so small a network gains nothing by more
    path = oysterbench.split("seg-mini").fetch("mini-01")["mini-01"]
    frames = list(oysterbench.torch.FrameDataset(path, layers=("oyster", "ignore"), transform=item))
    net, weight = network(), torch.tensor(2.0)
    optimiser = torch.optim.Adam(net.parameters(), lr=4e-3)
    for epoch in range(STEPS // 5):
        for image, oyster, asked in DataLoader(frames, batch_size=4, shuffle=True):
            said = net(image)[:, 0]
            each = nn.functional.binary_cross_entropy_with_logits(said, oyster, reduction="none", pos_weight=weight)
            loss = (each * asked).sum() / asked.sum()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        print(f"epoch {epoch + 1}: loss {loss.item():.3f}")
    torch.save(net.state_dict(), WEIGHTS)


class MyNet:
    name, track = "my_net", "segmentation"

    @property
    def weights(self):  # by whose content results are known: retrained, it is another network
        return {"my_net": WEIGHTS}

    def run(self, images):
        net = network()
        net.load_state_dict(torch.load(WEIGHTS, weights_only=True))
        for image in images:  # image.name, image.pixels (H, W, 3) uint8 RGB
            given = prepared(torch.from_numpy(image.pixels).permute(2, 0, 1))
            with torch.no_grad():
                said = nn.functional.interpolate(net(given[None]), size=image.pixels.shape[:2], mode="bilinear")
            yield Segmentation(image.name, probability=torch.sigmoid(said)[0, 0].numpy())


if __name__ == "__main__":
    train()
