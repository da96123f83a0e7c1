"""Rendered close-ups against real ones: colour, contrast, gradients and spectrum lie inside the real clips' spread."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from oysterbench.simulation import gallery
from tests.helpers.image_statistics import image_statistics

SHARE = (0.02, 0.98)  # of the real images: what lies between these quantiles counts as their spread


@pytest.fixture(scope="module")
def real(shared_data) -> pd.DataFrame:
    """Statistics of the real images that are for training, every third, for neighbours are near duplicates."""
    folder = shared_data / "real-oysters"
    if not folder.is_dir():
        pytest.skip(f"real images are absent: {folder}")
    manifest = pd.read_csv(folder / "manifest.csv")
    rows = []
    for name in manifest.id[manifest.split == "train"].iloc[::3]:
        pixels = cv2.imread(str(folder / "images" / f"{name}.jpg"), cv2.IMREAD_COLOR_RGB)
        assert pixels is not None
        rows.append(image_statistics(pixels))
    return pd.DataFrame(rows)


@pytest.fixture(scope="module")
def rendered() -> pd.DataFrame:
    """Statistics of the gallery's close-ups."""
    table = Path(str(resources.files("oysterbench_datasets") / "gallery" / "beside-real.toml"))
    pictures, captions = gallery.panels(table)
    return pd.DataFrame([image_statistics(picture) for picture in pictures], index=captions)


@pytest.mark.slow
def test_statistics_of_close_ups_lie_inside_the_spread_of_the_real_clips(real, rendered, capsys):
    low, high = real.quantile(SHARE[0]), real.quantile(SHARE[1])
    table = pd.DataFrame(
        {
            "real low": low,
            "real median": real.median(),
            "real high": high,
            "rendered low": rendered.min(),
            "rendered median": rendered.median(),
            "rendered high": rendered.max(),
        }
    )
    table["inside"] = [((rendered[key] >= low[key]) & (rendered[key] <= high[key])).mean() for key in table.index]
    with capsys.disabled():
        print(f"\n{table.round(2).to_string()}")
    median = rendered.median()
    outside = [key for key in table.index if not low[key] <= median[key] <= high[key]]
    assert not outside, table.loc[outside]
    assert np.mean(table["inside"]) > 0.75
