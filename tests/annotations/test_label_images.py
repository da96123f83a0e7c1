"""Folders that may be of masks or of a COCO file: which of their PNG files are label images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from PIL import Image

from oysterbench.annotations import open_truth
from oysterbench.annotations.label_images import is_label_image
from oysterbench.core.errors import LabelError
from tests.annotations.test_coco import laid
from tests.helpers.labelled_folders import HEIGHT, WIDTH, picture, write_png

NUMBERS = (np.arange(HEIGHT * WIDTH) * 40 // (HEIGHT * WIDTH)).reshape(HEIGHT, WIDTH).astype(np.uint8)
"""Forty oysters."""
COLOURS = np.stack((NUMBERS, NUMBERS // 2, NUMBERS // 3), axis=-1)


def write_palette(path, pixels):
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(pixels, "P")
    image.putpalette([k * 37 % 256 for k in range(768)])
    image.save(path)


def coco_2017(root, names="a"):
    """A COCO file in annotations/ of some images in a folder of their own, as COCO 2017 has them."""
    path = laid(root, "annotations/instances_val2017.json", "val2017")
    picture_path = root / "val2017" / "a.png"
    images = ", ".join(
        f'{{"id": {k}, "file_name": "{name}.png", "width": {WIDTH}, "height": {HEIGHT}}}'
        for k, name in enumerate(names, start=1)
    )
    path.write_text(f'{{"images": [{images}], "annotations": [], "categories": [{{"id": 1, "name": "oyster"}}]}}')
    for name in names[1:]:
        write_png(picture_path.with_stem(name), picture(1))
    return path


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("name", ["val2017/a", "val2017/a-mask", "masks/a", "mask_a", "masks/sub/A.mask"])
def test_masks_with_the_numbers_of_many_oysters_beside_a_coco_file_are_refused(name, kind, tmp_path):
    """Whether they stand in for the images, or are named after these."""
    path = coco_2017(tmp_path)
    assert [clip.names for clip in open_truth(tmp_path)] == [("a",)]
    write_png(tmp_path / f"{name}.png", NUMBERS.astype(kind))
    with pytest.raises(LabelError, match=rf"expected masks or COCO annotations, got both, such as .*{name}\.png"):
        open_truth(tmp_path)
    assert [clip.names for clip in open_truth(path)] == [("a",)]


@pytest.mark.parametrize("write", [write_png, write_palette])
@pytest.mark.parametrize(
    "name",
    [
        "site_depth4m_a-mask",
        "depth_03m/masks/1",
        "depth_10ft/masks/0",
        "site_depth_1/mask_0",
        "depth-5/labels/0",
        "mask_0001",
        "label0001",
        "masks/0001",
        "masks/a/0",
        "masks/amask",
        "segmentation/seg_0000",
        "Segmentations/1",
        "SegmentationClass/1",
        "SegmentationMask/1",
        "label/0",
        "labels_png/l0",
        "oystermask/m0",
        "trainmasks/1",
        "JsonToDataset/label",
        "gt/gt_0000",
        "seg/1",
        "task-1-annotation-1-by-1-tag-oyster-0",
    ],
)
def test_masks_by_their_own_names_beside_a_coco_file_are_refused(name, write, tmp_path):
    """Also with a palette, as VOC has them, where sites are named by their depths, and if some images are missing."""
    path = coco_2017(tmp_path, ["a", "site_depth4m_a", "c"])
    (tmp_path / "val2017" / "c.png").unlink()
    assert open_truth(path)[0].coco is not None
    write(tmp_path / f"{name}.png", NUMBERS)
    with pytest.raises(LabelError, match=rf"got both, such as .*{name}\.png"):
        open_truth(tmp_path)


def test_few_dark_or_flat_frames_among_many_are_no_masks(tmp_path):
    """Such as those of a monochrome camera at night, overexposed, or with a title."""
    coco_2017(tmp_path, "abcdefghi")
    dark = np.random.default_rng(0).poisson(0.02, (HEIGHT, WIDTH)).astype(np.uint8)
    write_png(tmp_path / "val2017" / "h.png", dark)
    title = cv2.rectangle(np.zeros((HEIGHT, WIDTH, 3), np.uint8), (2, 2), (WIDTH // 2, 4), (255, 255, 255), -1)
    write_png(tmp_path / "val2017" / "i.png", title)
    assert open_truth(tmp_path)[0].coco is not None
    write_png(tmp_path / "val2017" / "g.png", NUMBERS)
    with pytest.raises(LabelError, match="got both"):
        open_truth(tmp_path)


@pytest.mark.parametrize("pictures", ["b", "bc"])
def test_a_mask_in_place_of_one_of_several_images_is_refused(pictures, tmp_path):
    coco_2017(tmp_path, f"a{pictures}")
    assert open_truth(tmp_path)[0].coco is not None
    write_png(tmp_path / "val2017" / f"{pictures[-1]}.png", NUMBERS)
    with pytest.raises(LabelError, match=r"got both, such as .*val2017/[bc]\.png"):
        open_truth(tmp_path)


def test_masks_of_any_name_beside_a_coco_file_without_its_images_are_refused(tmp_path):
    coco_2017(tmp_path)
    (tmp_path / "val2017" / "a.png").rename(tmp_path / "val2017" / "photo.png")
    assert open_truth(tmp_path)[0].coco is not None
    write_png(tmp_path / "other" / "mask.png", NUMBERS)
    with pytest.raises(LabelError, match=r"got both, such as .*other/mask\.png"):
        open_truth(tmp_path)


@pytest.mark.parametrize(
    ("name", "pixels"),
    [
        ("annotations/panoptic_val2017/a", COLOURS),
        ("panoptic_val2017/a", COLOURS),
        ("annotations/stuff_val2017_pixelmaps/a", NUMBERS),
        ("stuffthingmaps/val2017/a", NUMBERS),
        ("depth/a", np.zeros((HEIGHT, WIDTH), np.uint16)),
        ("logo", NUMBERS),
        ("depth_maps/a", NUMBERS),
        ("a_depth", NUMBERS),
        ("runs/MaskPR_curve", COLOURS),
        ("docs/label_distribution", COLOURS),
        ("mask_rcnn/loss_0", COLOURS),
        ("labels/plots/0", COLOURS),
        ("labels/depth/a", NUMBERS),
        ("gt/disparity/a", NUMBERS),
        ("labels", NUMBERS),
        ("label_counts", NUMBERS),
        ("segmentation_results", NUMBERS),
        ("docs/label studio/icon", NUMBERS),
        ("seg1/dark", np.zeros((HEIGHT, WIDTH), np.uint8)),
        ("docs/how-to-mask/a", COLOURS),
        ("labelled/logo", NUMBERS),
        ("unlabelled/dark", np.zeros((HEIGHT, WIDTH), np.uint8)),
        ("plots/a_hist", COLOURS),
        ("thumbnails/a", picture(0)[::4, ::4]),
        ("val2017/black", np.zeros((HEIGHT, WIDTH, 3), np.uint8)),
        ("val2017/b", np.zeros((HEIGHT, WIDTH, 3), np.uint8)),
    ],
)
def test_other_pictures_of_few_colours_beside_a_coco_file_are_in_the_way_of_nothing(name, pixels, tmp_path):
    """As COCO itself publishes them, or one black frame among others."""
    coco_2017(tmp_path, "ab")
    write_png(tmp_path / f"{name}.png", pixels)
    assert [clip.names for clip in open_truth(tmp_path)] == [("a", "b")]


def test_grey_images_that_are_not_annotated_and_depths_are_no_masks(tmp_path):
    laid(tmp_path, "annotations/instances_val2017.json", "val2017")
    write_png(tmp_path / "val2017" / "b.png", picture(1)[..., 0])
    write_png(tmp_path / "depth" / "a.png", np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH))
    assert [clip.names for clip in open_truth(tmp_path)] == [("a",)]
    write_png(tmp_path / "val2017" / "a.png", np.repeat(picture(1)[..., :1], 3, axis=2))
    assert [clip.names for clip in open_truth(tmp_path)] == [("a",)]


def test_label_images_are_told_from_photographs(tmp_path):
    """Also where masks have soft edges, and photographs of turbid water are smooth, and were compressed."""
    rng = np.random.default_rng(1)
    mask = np.zeros((480, 640), np.uint8)
    for x, y in rng.integers(0, 480, (30, 2)).tolist():
        cv2.circle(mask, (x, y), 12, 255, -1, cv2.LINE_AA)
    water = cv2.resize(rng.uniform(20, 45, (8, 12)).astype(np.float32), (640, 480), interpolation=cv2.INTER_CUBIC)
    photo = np.clip(water + rng.normal(0, 1, water.shape), 0, 255).astype(np.uint8)
    photo = cv2.imdecode(cv2.imencode(".jpg", photo, [cv2.IMWRITE_JPEG_QUALITY, 75])[1], cv2.IMREAD_UNCHANGED)
    assert len(np.unique(mask)) > 32 > len(np.unique(photo[:, :1]))
    for name, pixels, expected in (("mask", mask, True), ("photo", photo, False), ("line", photo[:, :1], False)):
        write_png(tmp_path / f"{name}.png", pixels)
        assert is_label_image(tmp_path / f"{name}.png") == expected, name
