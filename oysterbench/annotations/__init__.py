"""Labelled images from any source, and predictions of methods: masks, polygons, COCO annotations."""

from oysterbench.annotations.coco import CocoFile, read_coco
from oysterbench.annotations.duplicates import Duplicate, check_leakage, near_duplicates
from oysterbench.annotations.folders import remove_image, write_folder
from oysterbench.annotations.forms import FORMS
from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, joined
from oysterbench.annotations.masks import MaskFiles, open_predictions
from oysterbench.annotations.opening import open_labelled
from oysterbench.annotations.runs import Run, ends_of, runs_of
from oysterbench.annotations.truth import LabelledSequence, labelled_sequence, open_truth

__all__ = [
    "FORMS",
    "CocoFile",
    "Duplicate",
    "Entry",
    "LabelledImage",
    "LabelledSequence",
    "LabelledSet",
    "MaskFiles",
    "Run",
    "check_leakage",
    "ends_of",
    "joined",
    "labelled_sequence",
    "near_duplicates",
    "open_labelled",
    "open_predictions",
    "open_truth",
    "read_coco",
    "remove_image",
    "runs_of",
    "write_folder",
]
