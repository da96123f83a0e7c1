"""Files to publish, a key to sign with, and a published split."""

from __future__ import annotations

import pytest

from tests.helpers.trees import SECRET, Published, a_key, write_split


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_split(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def secret_files(tmp_path_factory):
    return write_split(tmp_path_factory.mktemp("secret"), SECRET)


@pytest.fixture(scope="module")
def key_and_public(tmp_path_factory):
    return a_key(tmp_path_factory.mktemp("key"))


@pytest.fixture
def key(key_and_public):
    return key_and_public[0]


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    return Published(tmp_path_factory.mktemp("hub"))
