"""What tests of evaluation share: a corpus with a take of every content, what is judged of it, and who knows it all."""

import pytest

from moveset.evaluation.samples import open_test_set
from tests.bundles import tiny_bundle
from tests.evaluation.corpora import content_corpus
from tests.evaluation.judges import Oracle


@pytest.fixture(scope="session")
def corpus(tmp_path_factory):
    return content_corpus(tmp_path_factory.mktemp("corpus") / "corpus.safetensors")


@pytest.fixture(scope="session")
def items(corpus):
    return open_test_set(corpus, "test")


@pytest.fixture(scope="session")
def oracle(items):
    return Oracle(items)


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """The folder of a text-to-motion model."""
    return tiny_bundle(tmp_path_factory.mktemp("models") / "tiny")
