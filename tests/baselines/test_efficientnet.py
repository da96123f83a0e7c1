"""The encoder computes a convolution and its normalisation at once: as one after the other, forwards and backwards; and
the decoder on it an enlargement and a convolution."""

import math

import pytest

torch = pytest.importorskip("torch")

from torch.nn import functional  # noqa: E402

from oysterbench_baselines.learning import efficientnet  # noqa: E402
from oysterbench_baselines.learning.efficientnet import (  # noqa: E402
    Block,
    EfficientNetLite,
    SameConvolution,
    for_prediction,
)
from oysterbench_baselines.unet.network import UNetworkSettings, build_network  # noqa: E402


@pytest.fixture
def network():
    """With statistics and weights of normalisation that are not those of a new one."""
    torch.manual_seed(0)
    network = EfficientNetLite()
    for layer in network.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.running_mean.normal_()
            layer.running_var.uniform_(0.5, 2.0)
            torch.nn.init.uniform_(layer.weight, 0.5, 2.0)
            torch.nn.init.normal_(layer.bias)
    return network


def one_by_one(layers, values):
    """Padded on all sides, convolved, normalised, clamped."""
    for layer in layers:
        if isinstance(layer, SameConvolution):
            side, stride = layer.kernel_size[0], layer.stride[0]
            missing = [max((math.ceil(n / stride) - 1) * stride + side - n, 0) for n in values.shape[-2:]]
            (above, left), (below, right) = ([m // 2 for m in missing], [m - m // 2 for m in missing])
            padded = functional.pad(values, (left, right, above, below))
            values = functional.conv2d(padded, layer.weight, None, stride, groups=layer.groups)
        elif isinstance(layer, torch.nn.BatchNorm2d):
            mean, deviation = layer.running_mean, torch.sqrt(layer.running_var + layer.eps)
            by = layer.weight / deviation
            values = values * by[:, None, None] + (layer.bias - mean * by)[:, None, None]
        else:
            values = values.clamp(0, 6)
    return values


def features(network, values):
    """As `EfficientNetLite.features`."""
    values, levels = one_by_one(network.stem, values), []
    for stage in network.stages:
        for block in stage:
            found = one_by_one(block.layers, values)
            if stage is not network.stages[0] and block is stage[0] and found.shape[-1] < values.shape[-1]:
                levels.append(values)  # what the stage before ended with, before its size is halved
            values = values + found if block.adds else found
    return [*levels, values]


@pytest.mark.parametrize("size", [(64, 96), (45, 50)], ids=["even", "odd"])
@pytest.mark.parametrize("training", [False, True])
def test_features_and_gradients_are_those_of_one_layer_after_the_other(network, size, training):
    network.double().train(training)
    picture = torch.randn(1, 3, *size, dtype=torch.double).contiguous(memory_format=torch.channels_last)
    found = []
    for compute in (EfficientNetLite.features, features):
        network.zero_grad()
        levels = compute(network, picture)
        torch.stack([level.square().mean() for level in levels]).sum().backward()
        gradients = [one.grad.clone() for one in network.parameters() if one.grad is not None]
        found.append([*(level.detach() for level in levels), *gradients])
    assert len(found[0]) > 100
    assert [one.shape[-2:] for one in found[0][:5]] == [
        tuple(math.ceil(n / s) for n in size) for s in (2, 4, 8, 16, 32)
    ]
    for one, other in zip(*found, strict=True):
        assert torch.allclose(one, other, rtol=1e-6, atol=1e-9)


def test_a_network_for_prediction_has_no_normalisations_and_predicts_the_same(network):
    picture = torch.randn(1, 3, 45, 50)
    with torch.inference_mode():
        before = [*network.features(picture), network(picture)]
        folded = for_prediction(network)
        after = [*folded.features(picture), folded(picture)]
    assert not any(isinstance(part, torch.nn.BatchNorm2d) for part in folded.modules())
    assert len(before) == 6
    for one, other in zip(before, after, strict=True):
        assert torch.equal(one, other)
    assert for_prediction(folded) is folded, "twice changes nothing"
    with torch.inference_mode():
        assert torch.equal(folded(picture), after[-1])


@pytest.mark.parametrize("folded", [False, True])
@pytest.mark.parametrize(("room", "count"), [(40, 32), (88, 80)])
def test_a_block_predicts_the_same_in_parts(network, folded, room, count, monkeypatch):
    picture = torch.randn(1, 3, 160, 200).contiguous(memory_format=torch.channels_last)
    network = for_prediction(network) if folded else network.eval()
    with torch.inference_mode():
        whole = network.features(picture)
        monkeypatch.setattr(efficientnet, "PART_BYTES", room * 80 * 100 * 4)  # of the largest expansion, 96 channels
        in_parts, counts = Block._in_parts, []
        monkeypatch.setattr(Block, "_in_parts", lambda *of: counts.append(of[2]) or in_parts(*of))
        parts = network.features(picture)
    assert counts == [count]
    for one, other in zip(whole, parts, strict=True):
        assert torch.equal(one, other)


def test_the_decoder_predicts_what_it_computes_in_training():
    """In training it enlarges deep features before it convolves them, in prediction it does not."""
    torch.manual_seed(0)
    network = build_network(UNetworkSettings(groups=8, encoder="lite0", side=320)).eval()
    pixels = torch.rand(2, 3, 64, 96)
    with torch.inference_mode():
        predicted = network(pixels)
        learnt = network.train()(pixels)[:, :2]
    assert learnt.std() > 0.01
    assert torch.allclose(predicted, learnt, atol=1e-4)
