"""A dive in every format."""

from __future__ import annotations

import pytest

import oysterbench
from oysterbench.sequence.export import SHARED_FORMATS, export_sequence


@pytest.fixture(scope="package")
def sequence(dive_file):
    return oysterbench.open(dive_file)


@pytest.fixture(scope="package")
def folders(sequence, tmp_path_factory):
    """Every format, written once."""
    root = tmp_path_factory.mktemp("exports")
    return {form: export_sequence(sequence, form, root / form)[0] for form in SHARED_FORMATS}
