"""An encoder that is folded says what it said before."""

import pytest

torch = pytest.importorskip("torch")

from oysterbench_baselines.learning.efficientnet import EfficientNetLite, folded  # noqa: E402


def test_an_encoder_without_its_normalisation_has_the_same_features():
    torch.manual_seed(0)
    network = EfficientNetLite().eval()
    for layer in network.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):  # statistics and weights that are not those of a new network
            layer.running_mean.normal_()
            layer.running_var.uniform_(0.5, 2.0)
            torch.nn.init.uniform_(layer.weight, 0.5, 2.0)
            torch.nn.init.normal_(layer.bias)
    picture = torch.randn(1, 3, 64, 96).contiguous(memory_format=torch.channels_last)
    with torch.inference_mode():
        before = network.features(picture)
        after = folded(network).features(picture)
    assert not any(isinstance(layer, torch.nn.BatchNorm2d) for layer in network.modules())
    for one, other in zip(before, after, strict=True):
        assert float((one - other).abs().max()) < 1e-4 * float(one.abs().max())
