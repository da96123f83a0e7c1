"""Shards and cards: every picture with its planes and facts, for their own readers too; the same bytes each time."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image

import oysterbench
from oysterbench.annotations import LabelledSet, open_labelled
from oysterbench.annotations.export import SET_FORMATS, export_set
from oysterbench.annotations.export.examples import examples, parted
from oysterbench.annotations.export.webdataset import write as write_webdataset
from oysterbench.core.errors import LabelError, MissingExtraError
from oysterbench.recipe import CLASSES
from oysterbench.sequence.pictures import encoded_pictures
from tests.helpers.labelled_folders import picture, yolo_folder

ELSEWHERE = "/"
"""Where a program starts that imports `datasets`: in the checkout that is the folder of splits."""


@pytest.fixture(scope="module")
def labelled(dive_file):
    return open_labelled(dive_file)


@pytest.fixture(scope="module")
def tars(labelled, tmp_path_factory):
    return export_set([labelled], "webdataset", tmp_path_factory.mktemp("tars") / "out")[0]


@pytest.fixture(scope="module")
def tables(labelled, tmp_path_factory):
    pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra parquet)")
    return export_set([labelled], "parquet", tmp_path_factory.mktemp("tables") / "out")[0]


def samples(folder: Path) -> dict[str, dict[str, bytes]]:
    found: dict[str, dict[str, bytes]] = {}
    for path in sorted((folder / "data").glob("*.tar")):
        with tarfile.open(path) as tar:
            for member in tar:
                key, _, extension = member.name.partition(".")
                file = tar.extractfile(member)
                assert file is not None
                found.setdefault(key, {})[extension] = file.read()
    return found


def plane(data: bytes) -> np.ndarray:
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))


def card(folder: Path) -> tuple[dict[str, Any], str]:
    _, head, body = (folder / "README.md").read_text().split("---\n", 2)
    return yaml.safe_load(head), body


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_a_sample_holds_picture_planes_and_facts(labelled, tars):
    found = samples(tars)
    assert len(found) == len(labelled) == 4
    for example in examples(labelled.entries):
        sample, image = found[example.key], example.image
        assert np.array_equal(plane(sample["class.png"]), image.classes)
        assert np.array_equal(plane(sample["instance.png"]), image.instances)
        assert np.array_equal(plane(sample["ignore.png"]) > 0, image.ignore)
        facts = json.loads(sample["json"])
        assert (facts["id"], facts["clip"]) == (image.name, image.clip)
        assert facts["conditions"] == dict(image.conditions)
        for one in facts["objects"]:
            mask = image.instances == one["id"]
            y, x = np.nonzero(mask)
            assert one["bbox"] == [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
            assert one["area"] == mask.sum()
            assert one["category"] == CLASSES[int(image.classes[mask][0])]
        assert {one["id"] for one in facts["objects"]} == set(np.unique(image.instances[image.instances > 0]).tolist())


def test_states_are_those_of_the_truth(dive_file, tars):
    living = oysterbench.open(dive_file).living()
    objects = [one for sample in samples(tars).values() for one in json.loads(sample["json"])["objects"]]
    told = {one["id"]: one["state"] for one in objects}
    assert {number: {True: "live", False: "dead", None: "unknown"}[living.get(number)] for number in told} == told


def test_a_picture_is_passed_on_as_it_was_stored(dive_file, tars):
    stored = {picture.stamp_ns: picture for picture in encoded_pictures(oysterbench.open(dive_file), "cam_left")}
    for key, sample in samples(tars).items():
        picture = stored[int(key.rpartition("_")[2])]
        assert sample[f"image.{picture.form.replace('jpeg', 'jpg')}"] == picture.data


def test_the_same_set_gives_the_same_bytes(labelled, tars, tmp_path):
    again, _ = export_set([labelled], "webdataset", tmp_path / "again")
    assert digests(again) == digests(tars)
    with tarfile.open(next((again / "data").glob("*.tar"))) as tar:
        assert {(member.mtime, member.uid, member.uname) for member in tar} == {(0, 0, "")}


def test_a_full_shard_is_followed_by_another(labelled, tmp_path):
    notes = write_webdataset("x", parted([labelled]), tmp_path, lambda: None, shard_bytes=1)
    assert sorted(path.name for path in (tmp_path / "data").iterdir()) == [f"train-{k:05d}.tar" for k in range(4)]
    assert notes == ["train: 4 images in 4 shards"]
    assert len(samples(tmp_path)) == 4


def test_the_card_says_which_part_is_where(labelled, tmp_path):
    halves = [
        LabelledSet("seg-train", labelled.entries[:3]),
        LabelledSet("seg-val", labelled.entries[3:]),
    ]
    folder, _ = export_set(halves, "webdataset", tmp_path / "out")
    head, body = card(folder)
    assert head["configs"] == [
        {
            "config_name": "default",
            "data_files": [
                {"split": "train", "path": "data/train-*.tar"},
                {"split": "validation", "path": "data/val-*.tar"},
            ],
        }
    ]
    assert head["license"] == "cc-by-4.0"
    assert head["size_categories"] == ["n<1K"]
    assert "| train | 3 | 1 |" in body
    assert "| validation | 1 | 1 |" in body


def test_of_anybodys_photographs_no_licence_is_claimed_and_their_files_are_passed_on(tmp_path):
    square = "0 0.2 0.2 0.6 0.2 0.6 0.6 0.2 0.6\n"
    source = yolo_folder(tmp_path / "mine", {"reef-1": square, "reef-2": ""})
    folder, _ = export_set([open_labelled(source)], "webdataset", tmp_path / "out")
    head, body = card(folder)
    assert "license" not in head
    assert "synthetic" not in head["tags"]
    assert "licence is their owner's" in body
    found = samples(folder)
    assert sorted(found) == ["reef-1", "reef-2"]
    for key, sample in found.items():
        (file,) = (source / "images").glob(f"{key}.*")
        assert sample[f"image.{file.suffix[1:]}"] == file.read_bytes()


def jpeg(path: Path, orientation: int = 1) -> None:
    pixels = Image.fromarray(picture(0))
    exif = Image.Exif()
    exif[0x0112] = orientation
    pixels.save(path, exif=exif)


@pytest.mark.parametrize("other", ["png", "turned"])
def test_all_samples_have_the_same_fields_as_readers_want_it(other, tmp_path):
    """Also where some cannot be passed on as they are stored."""
    source = yolo_folder(tmp_path / "mine", {"a": "", "b": ""}, "id,clip,split\na,one,train\nb,two,test\n")
    for name in "ab"[: 1 if other == "png" else 2]:
        (source / "images" / f"{name}.png").unlink()
        jpeg(source / "images" / f"{name}.jpg", 3 if name == "b" else 1)
    mixed = open_labelled(source)
    folder, _ = export_set([mixed], "webdataset", tmp_path / "out")
    for sample, one in zip(samples(folder).values(), sorted(mixed, key=lambda one: one.name != "b"), strict=True):
        assert sorted(sample) == ["class.png", "ignore.png", "image.png", "instance.png", "json"]
        assert np.array_equal(plane(sample["image.png"])[..., ::-1], one.pixels)
    folder, _ = export_set([mixed.of_split("train")], "webdataset", tmp_path / "alone")
    assert samples(folder)["a"]["image.jpg"] == (source / "images" / "a.jpg").read_bytes()


def test_names_in_any_script_are_told_apart(tmp_path):
    source = yolo_folder(tmp_path / "mine", {"牡蛎": "", "海底": "", "क": "", "कि": ""})
    folder, _ = export_set([open_labelled(source)], "webdataset", tmp_path / "out")
    assert sorted(samples(folder)) == sorted(["牡蛎", "海底", "क", "कि"])


def test_sides_of_any_name_are_parts_that_hugging_face_can_tell_apart(tmp_path):
    sides = {"a": "test", "b": "test-hard", "c": "site 2/spring"}
    source = yolo_folder(tmp_path / "mine", dict.fromkeys(sides, ""))
    rows = [f"{name},{name},{side}\n" for name, side in sides.items()]
    (source / "manifest.csv").write_text("id,clip,split\n" + "".join(rows))
    folder, _ = export_set([open_labelled(source)], "webdataset", tmp_path / "out")
    for file in card(folder)[0]["configs"][0]["data_files"]:
        assert file["split"].isidentifier()
        assert len(list(folder.glob(file["path"]))) == 1
    assert len(card(folder)[0]["configs"][0]["data_files"]) == 3
    with open(source / "manifest.csv", "a") as table:
        table.write("d,d,test_hard\n")
    yolo_folder(source, dict.fromkeys([*sides, "d"], ""))
    with pytest.raises(LabelError, match="'test-hard' and 'test_hard' are both named test_hard in files"):
        export_set([open_labelled(source)], "webdataset", tmp_path / "other")


def test_names_may_be_as_long_as_those_of_files(tmp_path):
    name = "reef-" + 200 * "1"
    folder, _ = export_set([open_labelled(yolo_folder(tmp_path / "mine", {name: ""}))], "webdataset", tmp_path / "out")
    assert sorted(samples(folder)[name]) == ["class.png", "ignore.png", "image.png", "instance.png", "json"]


def test_two_images_of_one_name_are_refused(dive_file, tmp_path):
    sets = [open_labelled(dive_file), open_labelled(dive_file)]
    with pytest.raises(LabelError, match="two images have the same name, hand-made/cam_left"):
        export_set(sets, "webdataset", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("form", SET_FORMATS)
def test_what_is_interrupted_leaves_nothing(labelled, tmp_path, form):
    if form == "parquet":
        pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra parquet)")

    def interrupt(done, total):
        assert total == 4
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_set([labelled], form, tmp_path / "out", interrupt)
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_left_as_it_is(labelled, tars):
    before = digests(tars)
    with pytest.raises(LabelError, match="left unchanged"):
        export_set([labelled], "webdataset", tars)
    assert digests(tars) == before


def test_without_pyarrow_its_extra_is_named_and_what_does_without(labelled, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"oysterbench\[parquet\]', or choose the format webdataset"):
        export_set([labelled], "parquet", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_row_holds_the_same_as_a_sample(tables, tars):
    from pyarrow import parquet

    table = parquet.read_table(next((tables / "data").glob("*.parquet")))
    features = json.loads(table.schema.metadata[b"huggingface"])["info"]["features"]
    assert list(features) == table.column_names
    assert features["image"] == {"_type": "Image"}
    found = samples(tars)
    for row in table.to_pylist():
        key = row["class"]["path"].partition(".")[0]
        sample, facts = found[key], json.loads(found[key]["json"])
        for name in ("class", "instance", "ignore"):
            assert row[name]["bytes"] == sample[f"{name}.png"]
        assert row["image"]["bytes"] == next(data for name, data in sample.items() if name.startswith("image."))
        assert json.loads(row["conditions"]) == facts["conditions"]
        categories = features["objects"][0]["category"]["names"]
        assert [categories[one["category"]] for one in row["objects"]] == [one["category"] for one in facts["objects"]]
        assert [one["bbox"] for one in row["objects"]] == [one["bbox"] for one in facts["objects"]]


def test_the_same_set_gives_the_same_tables(labelled, tables, tmp_path):
    again, _ = export_set([labelled], "parquet", tmp_path / "again")
    assert digests(again) == digests(tables)


ABSENT = 77
DATASETS = f"""
import sys
try:
    from datasets import disable_progress_bars, load_dataset
except ImportError:
    sys.exit({ABSENT})
disable_progress_bars()
data = load_dataset(sys.argv[1], cache_dir=sys.argv[2])
row = data["train"][0]
assert len(data["train"]) == 4, data
instance = row.get("instance") or row["instance.png"]
assert (instance.mode, instance.size) == ("I;16", (64, 48)), instance
found = row["objects"] if "objects" in row else row["json"]["objects"]
assert [one["area"] for one in found], row
"""
WEBDATASET = f"""
import sys
try:
    import webdataset
except ImportError:
    sys.exit({ABSENT})
found = list(webdataset.WebDataset(sys.argv[1] + "/data/train-00000.tar", shardshuffle=False))
assert len(found) == 4, found
assert {{"class.png", "instance.png", "ignore.png", "json"}} <= set(found[0]), found[0].keys()
"""


@pytest.mark.parametrize(("form", "reader"), [("parquet", "datasets"), ("tars", "datasets"), ("tars", "webdataset")])
def test_their_own_readers_open_them(request, tmp_path, form, reader):
    folder = request.getfixturevalue("tables" if form == "parquet" else "tars")
    script = {"datasets": DATASETS, "webdataset": WEBDATASET}[reader]
    command = [sys.executable, "-c", script, str(folder), str(tmp_path)]
    environment = {"HOME": str(tmp_path), "HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1", "PATH": "/usr/bin:/bin"}
    result = subprocess.run(command, capture_output=True, text=True, cwd=ELSEWHERE, env=environment)
    if result.returncode == ABSENT:
        pytest.skip(f"{reader} is not installed")
    assert result.returncode == 0, result.stderr


def test_a_card_reads_as_yaml_whatever_the_name(labelled, tmp_path):
    odd = LabelledSet("a: #b", labelled.entries[:1])
    folder, _ = export_set([odd], "webdataset", tmp_path / "out")
    assert card(folder)[0]["pretty_name"] == "a: #b"
