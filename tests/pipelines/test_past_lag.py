"""A finished segment that is told noisily: the model's choice, what is asked for, and streams that stop and go on."""

import dataclasses
import itertools

import pytest
import torch

from moveset.errors import InputError
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.stream_settings import check_stream
from moveset.pipelines.stream_state import Snapshot

WALK = "a person walks forward"
ONE_BY_ONE = {"network": "rdm", "start": 6, "lag": 6}


@pytest.fixture
def opened(bundle, encoder):
    def open_stream(**options):
        request = check_stream(bundle.config, WALK, **{**ONE_BY_ONE, **options})
        return MotionStream(bundle, request, device="cpu", encoder=encoder)

    return open_stream


def roots(stream, count=3):
    return torch.cat([segment.motion.root for segment in itertools.islice(stream, count)])


@pytest.mark.parametrize(
    ("own", "options", "told"),
    [
        (None, {}, None),
        (2, {}, 2),
        (2, {"past_lag": 1}, 1),
        (2, {"past_lag": 6}, None),  # all the way is clean
        (2, {"steps": 12, "start": 12, "lag": 12}, 4),  # the same share of the way
        (1, {"steps": 3, "start": 3, "lag": 3}, 1),
        (2, {"lag": 3}, None),  # segments that overlap are told what there is
        (2, {"network": "md", "start": None, "lag": None}, None),
        (2, {"network": "pcm-1", "start": None, "lag": None}, None),
    ],
)
def test_the_model_says_how_it_is_told_its_past_unless_asked(bundle, own, options, told):
    config = dataclasses.replace(bundle.config, past_lag=own)
    settings = check_stream(config, WALK, **{**ONE_BY_ONE, **options}).settings
    assert settings.past_lag == told
    assert settings.clean_left == (settings.one_by_one and told is None)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"network": "rdm", "past_lag": 1}, "past_lag 1 is for network 'rdm' with a lag of all"),
        ({**ONE_BY_ONE, "past_lag": 7}, "past_lag 7 is not in 1 to 6"),
        ({**ONE_BY_ONE, "past_lag": 1.5}, "past_lag 1.5 is not a whole number"),
        ({"network": "pcm-1", "past_lag": 3}, "past_lag 3 is for network 'rdm'"),
    ],
)
def test_what_cannot_be_asked_for(bundle, options, said):
    with pytest.raises(InputError, match=said):
        check_stream(bundle.config, WALK, **options)


def test_it_changes_what_follows_the_first_segment(opened):
    clean, noisy = roots(opened()), roots(opened(past_lag=1))
    assert torch.equal(clean[:28], noisy[:28])
    assert not torch.allclose(clean[28:], noisy[28:], atol=1e-4)


def test_a_stream_goes_on_from_its_state_to_the_bit(opened, tmp_path):
    stream = opened(past_lag=1)
    roots(stream, 2)
    stream.save_state(tmp_path / "there.state")
    rest = roots(stream)
    again = opened().load_state(tmp_path / "there.state")
    assert again.settings.past_lag == 1
    assert torch.equal(roots(again), rest)


def test_a_state_of_before_there_was_a_choice_goes_on_clean(opened):
    stream = opened()
    roots(stream, 2)
    state = stream.state()
    numbers = {**state.numbers, "settings": {k: v for k, v in state.numbers["settings"].items() if k != "past_lag"}}
    assert torch.equal(roots(opened(past_lag=1).restore(Snapshot(numbers, state.tensors))), roots(stream))
