"""Labelled images, whatever they come from: rendered splits, YOLO polygons, COCO, folders of masks."""

from oysterbench.labelled.duplicates import Duplicate, check_leakage, near_duplicates
from oysterbench.labelled.folders import write_folder
from oysterbench.labelled.image import OYSTER, Entry, LabelledImage, LabelledSet, joined
from oysterbench.labelled.opening import open_labelled

__all__ = [
    "OYSTER",
    "Duplicate",
    "Entry",
    "LabelledImage",
    "LabelledSet",
    "check_leakage",
    "joined",
    "near_duplicates",
    "open_labelled",
    "write_folder",
]
