"""What may be asked of a stream: its method, its past, and whose time each segment lies in."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
import torch

from moveset.diffusion.phases import PhaseGrid
from moveset.errors import InputError
from moveset.pipelines.stream_settings import check_stream
from moveset.pipelines.timeline import share_evenly
from moveset.rdm.staircase import Staircase

WALK, BOW = "a person walks", "a person bows"
BOTH = "a person walks, then bows"
SEGMENT = 1.4  # seconds
ONE_BY_ONE = {"network": "rdm", "start": 6, "lag": 6}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"prompt": []}, "0 prompts"),
        ({"prompt": ""}, "empty"),
        ({"prompt": ["a"] * 65}, "65 prompts"),
        ({"seconds": 0.0}, "0 seconds"),
        ({"seconds": -2.0}, "-2 seconds"),
        ({"seconds": float("nan")}, "nan seconds"),
        ({"seconds": float("inf")}, "inf seconds"),
        ({"seconds": [1.0, 2.0]}, "2 durations do not fit 1 prompts"),
        ({"seed": -1}, "seed -1 is not in 0 to .*; give a whole number that is"),
        ({"seconds": torch.tensor(3.0)}, "is not a number"),
        ({"network": "gan"}, "unknown network 'gan'; model 'tiny-stream' has rdm, md, pcm-1, pcm-2"),
        ({"steps": 3}, "no student for 3 steps; choose 1, 2, or network 'rdm' or 'md'"),
        ({"network": "pcm-2", "steps": 4}, "takes 2 steps"),
        ({"network": "pcm-2", "eta": 0.5}, "eta 0.5"),
        ({"network": "pcm-2", "start": 1}, "start is 2, and its lag in 1 to 2; leave them out"),
        ({"network": "pcm-2", "lag": 3}, "lag in 1 to 2; leave them out"),
        ({"network": "md", "lag": 1}, "leave them out"),
        ({"network": "md", "start": 2}, "leave them out"),
        ({"network": "rdm", "steps": 0}, "0 steps"),
        ({"network": "rdm", "start": 9}, "start 9"),
        ({"network": "rdm", "lag": 0}, "lag 0"),
        ({"network": "rdm", "eta": 1.5}, "eta 1.5"),
        ({"network": "rdm", "eta": 1.0, "variance": "learned"}, "variance 'learned' is not one of posterior, beta"),
        ({"network": "rdm", "eta": 0.0, "variance": "beta"}, "eta is 0; set eta=1"),
        ({"network": "rdm", "eps_scale": 0.4}, "eps_scale 0.4 is not in 0.5 to 2"),
        ({"network": "rdm", "eps_scale": float("nan")}, "eps_scale nan"),
        ({"network": "pcm-1", "eps_scale": 1.1}, "eps_scale 1.1 does not go with the student 'pcm-1'"),
        ({"network": "rdm", "time_shift": -0.1}, "time_shift -0.1 is not in 0 to 1"),
        ({"network": "pcm-1", "time_shift": 0.1}, "time_shift 0.1 does not go with the student 'pcm-1'"),
        ({"guidance": float("nan")}, "guidance nan"),
        ({"guidance": -1.0}, "guidance -1"),
        ({"buffer": -1}, "buffer of -1"),
        ({"blend_seconds": -1.0}, "blend over -1"),
        ({"network": "rdm", "past_lag": 1}, "past_lag 1 is for network 'rdm' with a lag of all"),
        ({**ONE_BY_ONE, "past_lag": 7}, "past_lag 7 is not in 1 to 6"),
        ({**ONE_BY_ONE, "past_lag": 1.5}, "past_lag 1.5 is not a whole number"),
        ({"network": "pcm-1", "past_lag": 3}, "past_lag 3 is for network 'rdm'"),
        ({"stages": "False"}, "stages 'False' is neither true nor false"),
    ],
)
def test_what_cannot_be_asked_for(bundle, options, said):
    with pytest.raises(InputError, match=said):
        check_stream(bundle.config, **{"prompt": WALK, **options})


def test_the_model_says_which_variance_its_noise_has_unless_asked(bundle):
    config = dataclasses.replace(bundle.config, variance="beta")
    for options, wanted in (({}, "beta"), ({"variance": "posterior"}, "posterior")):
        settings = check_stream(config, WALK, network="rdm", eta=1.0, **options).settings
        assert settings.variance == settings.solver(config, None).variance == wanted


def test_the_model_says_how_its_noise_is_scaled_and_more_steps_scale_it_as_much_in_all(bundle):
    config = dataclasses.replace(bundle.config, sampler_steps=6, eps_scale=1.1, time_shift=0.2)
    for options, wanted in (
        ({"network": "rdm"}, (1.1, 0.2)),
        ({"network": "md", "steps": 12}, (1.1**0.5, 0.2)),
        ({"network": "rdm", "steps": 12, "eps_scale": 1.2, "time_shift": 0.0}, (1.2, 0.0)),
        ({"network": "pcm-1"}, (1.0, 0.0)),
    ):
        settings = check_stream(config, WALK, **options).settings
        for corrected in (settings, settings.solver(config, None)):
            assert (corrected.eps_scale, corrected.time_shift) == pytest.approx(wanted)


def test_numbers_of_numpy_become_those_that_a_state_can_hold(bundle):
    given = {"steps": 3, "start": 2, "lag": 2, "eta": 0.5, "eps_scale": 1.5, "guidance": 2.0, "seed": 7, "buffer": 1}
    as_numpy = {name: np.array(value)[()] for name, value in given.items()}
    request = check_stream(bundle.config, WALK, np.float64(2.8), network="rdm", **as_numpy)
    assert request == check_stream(bundle.config, WALK, 2.8, network="rdm", **given)
    assert json.loads(json.dumps([request.seed, vars(request.settings)])) == [7, vars(request.settings)]


def test_a_student_may_overlap_and_is_told_what_it_was_taught(bundle):
    """The segment before at the lower edge of the phase in which it is asked (``rdm_distillation``)."""
    settings = check_stream(bundle.config, WALK, network="pcm-2", lag=1).settings
    assert not settings.one_by_one
    assert settings.staircase() == Staircase(2, None, 2, lag=1)
    levels = settings.solver(bundle.config, None).levels
    asked, before = torch.tensor(levels[:-1]), torch.tensor(levels[1:])  # it is a step ahead
    assert torch.equal(PhaseGrid(bundle.config.points, 2, bundle.config.timesteps).below(asked), before)
    assert check_stream(bundle.config, WALK, network="pcm-2").settings.sequential


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
    ("prompts", "seconds", "starts", "counts"),
    [
        (BOTH, None, (0, 3), (6,)),
        (BOTH, 7 * SEGMENT, (0, 4), (7,)),
        (BOTH, SEGMENT, (0, 1), (2,)),
        ((WALK, BOTH, BOW), None, (0, 4, 7, 10), (4, 6, 4)),
        ((BOTH, BOW), (4 * SEGMENT, SEGMENT), (0, 2, 4), (4, 1)),
        ((BOTH, BOTH), 0.1, (0, 1, 2, 3), (2, 2)),
    ],
)
def test_stages_share_their_prompts_time(bundle, prompts, seconds, starts, counts):
    request = check_stream(bundle.config, prompts, seconds)
    assert (request.timeline.starts, request.counts) == (starts, counts)
    assert request.timeline.end == sum(counts)
    whole = check_stream(bundle.config, prompts, seconds, stages=False)
    assert whole.timeline.prompts == ((prompts,) if isinstance(prompts, str) else prompts)


def test_even_shares_differ_by_one_at_most():
    for count, length in itertools.product(range(1, 9), range(8, 20)):
        bounds = share_evenly(5, 5 + length, count)
        parts = [b - a for a, b in itertools.pairwise(bounds)]
        assert (bounds[0], bounds[-1], len(parts)) == (5, 5 + length, count)
        assert max(parts) - min(parts) <= 1 <= min(parts)
