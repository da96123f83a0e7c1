"""Sheets of pictures: previews, the gallery, and pictures beside real ones."""

from __future__ import annotations

import dataclasses
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.life import LifeRecipe
from oysterbench.simulation import gallery


def flat(value, width=40, height=30):
    return np.full((height, width, 3), value, dtype=np.uint8)


def test_a_preview_shows_frames_over_the_whole_sequence(tiny_split):
    seen = []
    picture = gallery.preview(tiny_split, progress=lambda done, total: seen.append((done, total)))
    assert picture.shape == (3 * (48 + gallery.CAPTION) + 4 * gallery.GAP, 4 * (64 + gallery.GAP) + gallery.GAP, 3)
    assert seen[-1] == (12, 12)
    tiles = [picture[6 : 6 + 48, 6 + k * 70 : 70 + k * 70] for k in range(4)]
    assert len({tile.tobytes() for tile in tiles}) == 4, "four different frames in the first row"


def test_cameras_are_shrunk_and_keep_their_field_of_view(tiny_split):
    (camera,) = gallery.shrink(tiny_split.rig, 32).camera
    assert (camera.width, camera.height, camera.hfov_deg) == (32, 24, 69.0)
    assert gallery.shrink(tiny_split.rig, 4000) == tiny_split.rig


def test_a_sheet_keeps_order_and_pictures():
    picture = gallery.sheet([flat(50), flat(100, 80, 60), flat(150)], ["a", "b", "c"], columns=2)
    assert picture[20, 20, 0] == 50
    assert picture[20, 70, 0] == 100
    assert picture[80, 20, 0] == 150


def test_every_panel_of_the_galleries_is_valid():
    folder = Path(str(resources.files("oysterbench_datasets") / "gallery"))
    files = sorted(folder.glob("*.toml"))
    assert {"reef.toml", "beside-real.toml"} <= {path.name for path in files}
    for path in files:
        split, rows = gallery._read_gallery(path)
        for row in rows:
            varied = gallery.vary_panel(split, row, path)
            assert 0 <= row["at_s"] < varied.sequence[0].duration_s


def test_every_effect_of_the_sea_has_a_panel():
    path = Path(str(resources.files("oysterbench_datasets") / "gallery" / "reef.toml"))
    _, rows = gallery._read_gallery(path)
    life = {field.name for field in dataclasses.fields(LifeRecipe)}
    sizes = {"school_fish_cm", "school_speed_m_s", "fish_speed_m_s", "surge_period_s"}
    wanted = {f"life.{key}" for key in life - sizes}
    wanted |= {"water.layer.factor", "water.patches.contrast", "water.plumes.attenuation", "water.snow_per_m3"}
    wanted |= {"water.forward_blur", "light.wind_m_s", "light.daylight", "light.occlusion_m", "site.wave_height_m"}
    growth = "drape infill_mm turf fouling grit burrows algae_per_m2 litter_per_m2 shell_spread plant_cover"
    wanted |= {f"reef.{key}" for key in growth.split()} | {"light.shade"}
    camera = "auto_exposure auto_balance shutter_ms readout_ms aperture_mm port_spots port_mm hot_pixels gain repeats"
    camera += " softness_px denoising sharpening contrast saturation"
    wanted |= {f"camera.{key}" for key in f"{camera} dropout video_mbit_s vignetting lens".split()}
    wanted |= {"sonar.volume_db", "sonar.interference", "dvl.invalid", "dvl.outliers", "imu.warming_k"}
    wanted |= {"imu.vibration", "magnetometer.throttle_deg"}
    shown = {key for row in rows for key in row["set"]}
    shown |= {f"{block}.{key}" for row in rows for block, keys in row["set"].get("rig", {}).items() for key in keys}
    assert not wanted - shown
    assert {row["layer"] for row in rows if "layer" in row} >= {"dynamic", "flow", "transmittance"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("split = 3", "expected `split = NAME` and at least one"),
        (
            "split = 'slam-mini'\n[[panel]]\ncaption = 'x'\nat_s = 'now'\nset = {}",
            "panel 1: key 'at_s': expected seconds",
        ),
        ("split = ", "not valid TOML"),
    ],
)
def test_a_bad_gallery_file_is_named(tmp_path, text, message):
    path = tmp_path / "g.toml"
    path.write_text(text)
    with pytest.raises(RecipeError, match=rf"g\.toml: .*{message}"):
        gallery.panels(path)
    with pytest.raises(RecipeError, match="no such gallery file"):
        gallery.panels(tmp_path / "absent.toml")


def test_real_pictures_are_spread_over_the_folder_and_a_bad_one_is_named(tmp_path):
    (tmp_path / "images").mkdir()
    for k in range(10):
        cv2.imwrite(str(tmp_path / "images" / f"{k}.jpg"), flat(20 * k))
    assert [name for name, _ in gallery.real_pictures(tmp_path, 4)] == ["0", "3", "6", "9"]
    (tmp_path / "images" / "0.jpg").write_text("no image")
    with pytest.raises(RecipeError, match=r"0\.jpg: expected an image"):
        list(gallery.real_pictures(tmp_path, 4))
    with pytest.raises(RecipeError, match=r"expected a folder with images"):
        gallery.gallery(tmp_path / "absent")


def test_a_picture_is_written_by_its_suffix(tmp_path):
    gallery.write_picture(tmp_path / "a.png", flat([10, 20, 30]))
    assert cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_COLOR_RGB)[0, 0].tolist() == [10, 20, 30]
