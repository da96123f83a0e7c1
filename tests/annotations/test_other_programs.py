"""Annotations that are of no kind that is read: which program wrote them is said, and what to do."""

from __future__ import annotations

import json

import pytest

from oysterbench.annotations import open_labelled, open_truth
from oysterbench.core.errors import LabelError
from tests.annotations.test_coco import laid

LABELME = {"version": "5.0", "shapes": [], "imagePath": "a.png"}
VIA = {"a.png12": {"filename": "a.png", "size": 12, "regions": [], "file_attributes": {}}}


@pytest.mark.parametrize(
    ("program", "content"), [("LabelMe", LABELME), ("VIA", VIA), ("VIA", {"_via_img_metadata": VIA})]
)
def test_annotations_of_other_programs_are_refused_by_their_name(program, content, tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(content))
    with pytest.raises(LabelError, match=rf"a\.json: .*, got annotations of {program}: export or convert them to COCO"):
        open_labelled(tmp_path)
    (tmp_path / "b.json").write_text(json.dumps(content))
    for opened in (open_labelled, open_truth):
        with pytest.raises(LabelError, match=rf"got 2 JSON files, as a\.json of {program}: export or convert them"):
            opened(tmp_path)


def test_panoptic_annotations_are_refused_as_such(tmp_path):
    path = laid(tmp_path, "annotations/panoptic_val2017.json", "val2017")
    content = json.loads(path.read_text())
    content["annotations"] = [{"image_id": 1, "file_name": "a.png", "segments_info": [{"id": 1, "category_id": 1}]}]
    path.write_text(json.dumps(content))
    with pytest.raises(LabelError, match="expected annotations of instances, got panoptic ones"):
        open_labelled(tmp_path)
