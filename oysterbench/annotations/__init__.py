"""Labelled images, whatever they come from, and what methods say of images: masks, polygons, COCO annotations."""

from oysterbench.annotations.duplicates import Duplicate, check_leakage, near_duplicates
from oysterbench.annotations.folders import write_folder
from oysterbench.annotations.image import OYSTER, Entry, LabelledImage, LabelledSet, joined
from oysterbench.annotations.masks import FORMS, MaskFiles, open_answers
from oysterbench.annotations.opening import open_labelled
from oysterbench.annotations.predicted_coco import CocoFile, read_coco
from oysterbench.annotations.truth import Clip, open_truth, sequence_clip

__all__ = [
    "FORMS",
    "OYSTER",
    "Clip",
    "CocoFile",
    "Duplicate",
    "Entry",
    "LabelledImage",
    "LabelledSet",
    "MaskFiles",
    "check_leakage",
    "joined",
    "near_duplicates",
    "open_answers",
    "open_labelled",
    "open_truth",
    "read_coco",
    "sequence_clip",
    "write_folder",
]
