"""Every limit refuses in one sentence that names the value, the limit and the remedy."""

import numpy as np
import pytest
import torch

from moveset.errors import InputError
from moveset.pipelines.model_config import ClipConfig, ModelSpec
from moveset.pipelines.request import check_method, check_request

SPEC = ModelSpec(kind="none", config={})
CONFIG = ClipConfig(
    name="m",
    models=dict.fromkeys(("vae", "teacher", "lcm-1", "pcm-1", "pcm-2", "pcm-4"), SPEC),
    guidance={"teacher": 2.0, "lcm-1": 3.0, "pcm-1": 4.0, "pcm-2": 5.0, "pcm-4": 6.0},
)


def test_variants_count_seeds_up():
    requests = check_request(CONFIG, "walk", 4.0, seed=7, num=3)
    assert [r.seed for r in requests] == [7, 8, 9]
    assert requests[2] == check_request(CONFIG, "walk", 4.0, seed=9)[0]
    assert requests[0].frames == (80,)


def test_one_duration_serves_all_prompts():
    assert check_request(CONFIG, ["a", "b"], 2.0)[0].frames == (40, 40)
    assert check_request(CONFIG, ["a", "b"], [2.0, 3.0])[0].frames == (40, 60)
    assert check_request(CONFIG, ["a", "b"])[0].frames == (None, None)


def test_numbers_of_numpy_are_numbers():
    [made] = check_request(CONFIG, "a", np.float32(2.0), seed=np.int64(3), num=np.int64(1))
    assert made == check_request(CONFIG, "a", 2.0, seed=3)[0]
    assert type(made.seed) is int
    assert type(check_method(CONFIG, steps=np.int64(2)).steps) is int


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"prompt": ""}, "the prompt is empty; describe"),
        ({"prompt": " \n"}, "the prompt is empty"),
        ({"prompt": []}, "0 prompts"),
        ({"prompt": ["a"] * 65}, "65 prompts were given; give 1 to 64"),
        ({"prompt": "a" * 10_240}, "10,240 characters, more than the limit of 1,000; shorten"),
        ({"prompt": "a\0b"}, "control characters"),
        ({"prompt": "a \ud83d walks"}, r"'a \\ud83d walks' is not valid Unicode; give it as UTF-8"),
        ({"seconds": 0.0}, r"0 seconds are not in 1 to 9\.8 for a prompt; give at least 1$"),
        ({"seconds": 9.9}, r"9\.9 seconds are not in 1 to 9\.8 for a prompt; for a longer motion give several prompts"),
        ({"seconds": 1e6}, r"1e\+06 seconds"),
        ({"seconds": -1.0}, "-1 seconds"),
        ({"seconds": float("nan")}, "nan seconds"),
        ({"seconds": float("inf")}, "inf seconds"),
        ({"seconds": [1.0, 2.0]}, "2 durations do not fit 1 prompts"),
        ({"prompt": [None]}, "the prompt None is no text"),
        ({"prompt": None}, "the prompt None is no text"),
        ({"seconds": "3"}, r"duration '3' is not a number; give seconds from 1 to 9\.8"),
        ({"seconds": [None, "3"], "prompt": ["a", "b"]}, "duration '3'"),
        ({"seconds": torch.tensor(3.0)}, r"duration tensor\(3\.\) is not a number"),
        ({"seed": 1.5}, "seed 1.5 is not a whole number"),
        ({"num": 2.0}, "num 2.0 is not a whole number"),
        ({"seed": -1}, "seed -1 is not in 0 to"),
        ({"seed": 2**63}, "is not in 0 to"),
        ({"num": 0}, "num 0 is not in 1 to 1000"),
        ({"num": 1001}, "num 1001"),
    ],
)
def test_requests_out_of_range(given, message):
    with pytest.raises(InputError, match=message):
        check_request(CONFIG, **{"prompt": "a", **given})


def test_methods():
    assert check_method(CONFIG).network == "pcm-1"
    assert check_method(CONFIG, steps=4).guidance == 6.0
    assert check_method(CONFIG, "lcm").network == "lcm-1"
    teacher = check_method(CONFIG, "teacher")
    assert (teacher.network, teacher.steps, teacher.guidance) == ("teacher", 50, 2.0)
    assert check_method(CONFIG, guidance=0.0).guidance == 0.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"solver": "euler"}, "unknown solver 'euler'; choose one of pcm, lcm, teacher"),
        ({"steps": 3}, "no pcm student for 3 steps; choose 1, 2, 4"),
        ({"steps": 0}, "no pcm student for 0 steps"),
        ({"steps": 1.0}, "steps 1.0 is not a whole number; give one such as 1"),
        ({"steps": "1"}, "steps '1' is not a whole number"),
        ({"solver": "teacher", "steps": 9.5}, "steps 9.5 is not a whole number"),
        ({"solver": "lcm", "steps": 2}, "no lcm student for 2 steps; choose 1"),
        ({"solver": "teacher", "steps": 1}, "1 steps are not in 2 to 500"),
        ({"solver": "teacher", "steps": 10**9}, "not in 2 to 500"),
        ({"guidance": -0.5}, "guidance -0.5 is not in 0 to 30; this model's own choice is 4"),
        ({"guidance": float("nan")}, "guidance nan"),
        ({"guidance": "2"}, "guidance '2' is not a number"),
        ({"guidance": [2.0]}, r"guidance \[2\.0\] is not a number"),
    ],
)
def test_methods_out_of_range(given, message):
    with pytest.raises(InputError, match=message):
        check_method(CONFIG, **given)


def test_a_model_without_teacher_says_so():
    config = ClipConfig(name="m", models={"pcm-1": SPEC}, guidance={"pcm-1": 1.0})
    with pytest.raises(InputError, match="comes without its teacher"):
        check_method(config, "teacher")
    with pytest.raises(InputError, match="has no lcm students"):
        check_method(config, "lcm")


def test_a_number_too_large_for_a_float_is_no_duration_and_no_guidance():
    with pytest.raises(InputError, match="the duration is a whole number of 1,329 bits"):
        check_request(CONFIG, "a", 10**400)
    with pytest.raises(InputError, match="guidance is a whole number of 16,610 bits"):
        check_method(CONFIG, guidance=10**5000)
