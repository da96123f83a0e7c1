"""Data sets for training with PyTorch: frames with masks, real images, and windows of images, IMU samples and poses.

>>> import oysterbench
>>> frames = oysterbench.torch.FrameDataset("mini-01.mcap", layers=("oyster", "instance"))
>>> frames[0]["image"].shape, frames[0]["oyster"].dtype
(torch.Size([3, 48, 64]), torch.bool)
>>> windows = oysterbench.torch.WindowDataset("mini-01.mcap", length=5)
>>> windows[0]["imu"].shape                   # between frames: angular rate and specific force of each sample
torch.Size([4, 10, 6])

A split is rendered or downloaded on first use. Files are indexed once, when a data set is made; reading an item then
touches only the chunks that hold it. Data sets can be pickled, forked and spawned: none keeps a file open.
"""

from importlib.util import find_spec

from oysterbench.core.errors import MissingExtraError

if find_spec("torch") is None:
    raise MissingExtraError(
        "oysterbench.torch needs PyTorch, which is not installed; type: pip install 'oysterbench[learn]'", name="torch"
    )

from oysterbench.torch.frames import FrameDataset
from oysterbench.torch.labelled import LabelledDataset
from oysterbench.torch.windows import WindowDataset

__all__ = ["FrameDataset", "LabelledDataset", "WindowDataset"]
