"""What tests of recurrent models share, made once in each file: a folder with a corpus, and RDM-7 in it."""

import pytest

from tests.training.recurrent import trained
from tests.training.segment_corpus import use_words, write_corpus


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a corpus, in whose trainings words stand for sentences."""
    with pytest.MonkeyPatch.context() as patch:
        use_words(patch)
        made = tmp_path_factory.mktemp("runs")
        write_corpus(made)
        yield made


@pytest.fixture(scope="module")
def rdm7(folder):
    """RDM-7 where students look for their teacher, and the result of its training."""
    return trained(folder, "rdm-7", folder / "rdm-7", steps=4, validate_every=4)
