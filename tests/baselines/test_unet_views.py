"""Pictures of small oysters are looked at more closely than others, and those of large ones from farther away."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from oysterbench_baselines.unet.instances import Division  # noqa: E402
from oysterbench_baselines.unet.model import UNetModel  # noqa: E402
from oysterbench_baselines.unet.network import PretrainedUNetwork  # noqa: E402
from oysterbench_baselines.unet.views import closer_zoom, fitting_zoom  # noqa: E402


def reef(radius, count, side=640):
    """(side / 2, side) uint8, bright where one of `count` oysters is, which grows darker towards its border."""
    rows, columns = np.mgrid[: side // 2, :side]
    found = np.zeros(rows.shape)
    for k in range(count):
        y, x = (k // 10 + 0.5) * side / 10, (k % 10 + 0.5) * side / 10
        found = np.maximum(found, 1 - np.hypot(rows - y, columns - x) / radius)
    return (255 * np.sqrt(found.clip(0))).astype(np.uint8)


def logits(grey):
    return np.stack([8.0 * (grey > 0) - 4.0, grey / 32.0 - 2.0]).astype(np.float32)


@pytest.mark.parametrize(
    ("radius", "count", "zoom"),
    [(8, 40, 5 / 3), (30, 40, 1.0), (8, 10, 1.0), (8, 0, 1.0), (120, 1, 0.5)],
)
def test_the_zoom_is_that_at_which_oysters_have_the_size_that_is_known_best(radius, count, zoom):
    assert fitting_zoom(logits(reef(radius, count))) == zoom
    assert fitting_zoom(logits(reef(radius / 2, count, side=320))) == zoom, "whatever the size of the picture"


def test_the_zoom_has_no_steps_towards_large_oysters():
    for radius in (58, 62, 70):
        grey = reef(radius, 1)
        size = np.sqrt((grey > 0).sum()) / 2
        assert fitting_zoom(logits(grey)) == pytest.approx(32 / size, rel=0.01)


def test_large_oysters_that_come_out_in_pieces_are_large():
    crumbs = np.maximum(reef(8, 40), np.roll(reef(120, 1), 160, axis=0))
    assert fitting_zoom(logits(reef(8, 40))) == 5 / 3
    assert fitting_zoom(logits(crumbs)) < 0.7


def test_a_closer_look_at_a_squarer_picture_has_as_many_pixels():
    assert closer_zoom(360, 640) == closer_zoom(480, 640) == closer_zoom(640, 480) == 5 / 3
    for height, width in ((640, 640), (600, 640), (512, 640)):
        zoom = closer_zoom(height, width)
        assert zoom == closer_zoom(width, height)
        assert zoom**2 * height * width == pytest.approx((5 / 3) ** 2 * 640 * 480)


class Seeing(PretrainedUNetwork):
    """A network that sees what is bright, and keeps the sides of what it has been shown."""

    def __init__(self):
        torch.nn.Module.__init__(self)
        self.shown = []

    def forward(self, pixels):
        self.shown.append(max(pixels.shape[2:]))
        return torch.cat([10 * (pixels[:, :1] - pixels.min()) - 1, 2 * pixels[:, :1]], dim=1)


@pytest.mark.parametrize(
    ("radius", "views", "zoom", "shown"),
    [(8, 1, 1.0, [320]), (8, 2, 2.5, [320, 533]), (8, 4, 2.5, [320, 533, 320, 533]), (30, 2, 1.0, [320, 448])],
)
def test_a_picture_of_small_oysters_is_looked_at_enlarged(radius, views, zoom, shown):
    grey = reef(radius, 40)
    network = Seeing()
    look = UNetModel(network, 1.0, 1, torch.device("cpu"), side=320, views=views).look(np.stack([grey] * 3, axis=-1))
    assert (look.zoom, network.shown) == (zoom, shown)
    assert look.logits.shape == (2, *grey.shape)
    assert ((look.logits[0] > 0) == (grey > 0)).mean() > 0.95, "laid over the picture as it is"


def test_a_square_picture_is_enlarged_less():
    grey = np.vstack([reef(8, 40), reef(8, 40)])
    network = Seeing()
    look = UNetModel(network, 1.0, 1, torch.device("cpu"), side=320, views=2).look(np.stack([grey] * 3, axis=-1))
    assert network.shown == [320, 462]
    assert look.zoom == pytest.approx(1.5 * 462 / 320, rel=1e-3)


def test_a_closer_look_that_shows_other_oysters_is_not_used_alone():
    class Silted(Seeing):
        def forward(self, pixels):
            return super().forward(pixels) + (1.5 if max(pixels.shape[2:]) == 533 else 0.0)

    grey, network = reef(8, 40), Silted()
    look = UNetModel(network, 1.0, 1, torch.device("cpu"), side=320, views=2).look(np.stack([grey] * 3, axis=-1))
    assert (look.zoom, network.shown) == (1.0, [320, 533])
    assert ((look.logits[0] > 0) == (grey > 0)).mean() > 0.95


@pytest.mark.parametrize(
    ("views", "zoom", "shown"), [(1, 1.0, [320]), (2, 0.5, [320, 160, 224]), (4, 0.5, [320, 160, 224, 160, 224])]
)
def test_a_picture_of_large_oysters_is_looked_at_from_farther_away(views, zoom, shown):
    grey, network = reef(120, 1), Seeing()
    look = UNetModel(network, 1.0, 1, torch.device("cpu"), side=320, views=views).look(np.stack([grey] * 3, axis=-1))
    assert (look.zoom, network.shown) == (zoom, shown)
    assert look.logits.shape == (2, *grey.shape)
    assert ((look.logits[0] > 0) == (grey > 0)).mean() > 0.95, "laid over the picture as it is"


def test_finer_things_are_told_apart_in_what_was_enlarged_and_coarser_ones_in_what_was_reduced():
    division = Division(smooth=1.0, area=12.0, rise=0.08, sure=0.3)
    assert division.zoomed(2.0) == Division(smooth=0.5, area=3.0, rise=0.08, sure=0.3)
    assert division.zoomed(0.5) == Division(smooth=2.0, area=48.0, rise=0.08, sure=0.3)
    assert division.zoomed(1.0) == division
