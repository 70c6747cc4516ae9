"""What tests of recurrent models share."""

import shutil

import pytest


@pytest.fixture(scope="session")
def rdm7(tiny_run, tmp_path_factory):
    """RDM-7 as it is after its training: the task and the result."""
    copied = tmp_path_factory.mktemp("rdm-7") / "run"
    shutil.copytree(tiny_run.runs / "rdm-7", copied)
    return tiny_run.train("rdm-7", copied, steps=4, resume=True)
