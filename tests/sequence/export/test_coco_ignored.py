"""Oysters that do not count are ignored in COCO exports too, by our evaluator and by pycocotools."""

from __future__ import annotations

import contextlib
import io
import json

import numpy as np
import pytest

from oysterbench.evaluate.detection.instances import from_planes
from oysterbench.recipe import OYSTER
from oysterbench.sequence.countable import countable
from oysterbench.sequence.export.coco import annotate
from oysterbench.tracks import TRACKS

STONE = 3


def planes():
    """Layers class, instance and visibility: two oysters that count, one too small, one too hidden, a tiny stone."""
    instances = np.zeros((40, 60), np.uint16)
    instances[2:12, 2:14], instances[20:34, 5:25] = 1, 2
    instances[5:7, 30:33], instances[20:30, 40:50], instances[0, 50:53] = 3, 4, 5
    classes = np.where(instances == 5, STONE, np.where(instances > 0, OYSTER, 1)).astype(np.uint8)
    visibility = np.where(instances == 4, 0.05, 1.0).astype(np.float32)
    return classes, instances, visibility


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools
def test_the_ground_truth_is_right_by_the_export(tmp_path):
    api, evaluation = pytest.importorskip("pycocotools.coco"), pytest.importorskip("pycocotools.cocoeval")
    annotations = [{"id": k, "image_id": 1, **one} for k, one in enumerate(annotate(*planes()), start=1)]
    assert {one["instance"]: one["iscrowd"] for one in annotations} == {1: 0, 2: 0, 3: 1, 4: 1, 5: 0}
    images = [{"id": 1, "file_name": "a.png", "width": 60, "height": 40}]
    categories = [{"id": OYSTER, "name": "oyster"}, {"id": STONE, "name": "stone"}]
    true, mine = tmp_path / "instances.json", tmp_path / "mine.json"
    true.write_text(json.dumps({"images": images, "categories": categories, "annotations": annotations}))
    _, instances, _ = planes()
    kept, _ = countable(*planes())
    assert set(np.unique(kept)) == {0, 1, 2, 5}
    results = [
        {
            "image_id": 1,
            "category_id": OYSTER,
            "score": 0.8 + 0.05 * k,
            "bbox": list(one.box),
            "segmentation": {**one.mask, "counts": one.mask["counts"].decode()},
        }
        for k, one in enumerate(from_planes("a", np.where(np.isin(instances, (1, 2, 4)), instances, 0)).instances)
    ]
    assert len(results) == 3
    mine.write_text(json.dumps(results[:2]))
    metrics = TRACKS["detection"].score_files(true, mine, {}).runs[0].record.metrics
    assert (metrics["ap_mask"], metrics["ap_box"], metrics["count_bias"]) == (1.0, 1.0, 0.0)
    for given in (results[:2], results):  # also where an oyster that does not count was found
        mine.write_text(json.dumps(given))
        assert TRACKS["detection"].score_files(true, mine, {}).runs[0].record.metrics["ap_mask"] == 1.0
        with contextlib.redirect_stdout(io.StringIO()):
            coco = api.COCO(str(true))
            theirs = evaluation.COCOeval(coco, coco.loadRes(str(mine)), "segm")
            theirs.params.catIds = [OYSTER]
            theirs.evaluate()
            theirs.accumulate()
            theirs.summarize()
        assert theirs.stats[0] == pytest.approx(1.0)
