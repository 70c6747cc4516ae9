"""Seeds, batches, timelines and methods of ``TextToMotion``, on random weights."""

import copy
import pickle
import shutil

import pytest
import torch

from moveset.errors import InputError
from moveset.pipelines.request import check_method
from moveset.pipelines.text_to_motion import TextToMotion
from tests.bundles import CAPTIONS

PROMPT = "a person walks forward and waves"


@pytest.fixture(scope="module")
def t2m(tiny_clips):
    return TextToMotion.from_pretrained(tiny_clips, device="cpu")


def same(a, b):
    return torch.equal(a.rotations, b.rotations) and torch.equal(a.root, b.root)


def test_one_seed_one_motion(t2m):
    first, again, other = (t2m(PROMPT, seconds=2.0, seed=seed).motion for seed in (7, 7, 8))
    assert same(first, again)
    assert not same(first, other)
    assert len(first) == 40
    assert torch.isfinite(first.joints).all()


def test_batches_of_unlike_prompts_and_lengths(t2m):
    """Padding of text and of frames must not leak into a clip."""
    prompts = ["a person bows", "someone walks forward slowly and then waves with both hands above the head"]
    together = t2m(prompts, seconds=[1.0, 3.0], foot_lock=False, batch=2)
    alone = t2m(prompts, seconds=[1.0, 3.0], foot_lock=False, batch=1)
    torch.testing.assert_close(together.motion.joints, alone.motion.joints, atol=1e-5, rtol=0)


def test_of_nothing_nothing_is_made(t2m):
    assert t2m.generate([], check_method(t2m.bundle.config)) == ()


@pytest.mark.parametrize(
    ("batch", "said"), [(0, "batch 0 is not at least 1"), ("1", "batch '1' is not a whole number")]
)
def test_a_batch_that_is_none_is_refused(t2m, batch, said):
    with pytest.raises(InputError, match=said):
        t2m(PROMPT, seconds=2.0, batch=batch)


@pytest.mark.parametrize(
    ("given", "evaluations"),
    [
        ({"steps": 1}, 1),
        ({"steps": 2}, 2),
        ({"steps": 4}, 4),
        ({"solver": "lcm"}, 1),
        ({"solver": "teacher", "steps": 5}, 10),
    ],
)
def test_evaluations_are_counted(t2m, given, evaluations):
    made = t2m(PROMPT, seconds=1.0, **given)
    assert made.network_evaluations == evaluations
    assert t2m([PROMPT, PROMPT], seconds=1.0, num=2, **given).network_evaluations == 2 * evaluations


def test_methods_differ(t2m):
    made = [t2m(PROMPT, seconds=1.0, **m).motion for m in ({}, {"steps": 2}, {"solver": "lcm"}, {"solver": "teacher"})]
    assert not any(same(a, b) for k, a in enumerate(made) for b in made[:k])


def test_guidance_reaches_student_and_teacher(t2m):
    for method in ({}, {"solver": "teacher", "steps": 4}):
        assert not same(*(t2m(PROMPT, seconds=1.0, guidance=w, **method).motion for w in (0.0, 9.0)))


def test_the_text_reaches_the_motion(t2m):
    assert not same(*(t2m(prompt, seconds=1.0).motion for prompt in ("a person bows", "a man runs fast")))


def test_a_timeline_holds_every_clip(t2m):
    made = t2m(["a person bows", "a man runs fast"], seconds=[1.0, 2.0])
    assert made.prompts == ("a person bows", "a man runs fast")
    assert made.seconds == 3.0
    # No pop: the fastest joint of the joined clip is not much faster than that of its parts.
    speed = (made.raw[0].joints[1:] - made.raw[0].joints[:-1]).norm(dim=-1).max()
    parts = [t2m(p, seconds=2.0, foot_lock=False).motion.joints for p in made.prompts]
    assert speed < 2.0 * max(float((j[1:] - j[:-1]).norm(dim=-1).max()) for j in parts)


def test_length_is_predicted_inside_the_limits(t2m):
    config = t2m.bundle.config
    assert config.min_frames <= len(t2m("a person bows").motion) <= config.max_frames


def test_far_prompts_are_warned_about(t2m):
    assert not t2m(CAPTIONS[0], seconds=1.0).warnings
    [warning] = t2m("quarterly tax revenue of Liechtenstein", seconds=1.0).warnings
    assert "'quarterly tax revenue of Liechtenstein' is unlike anything" in warning
    assert any(repr(caption) in warning for caption in CAPTIONS)


def test_prompts_that_are_cut_are_warned_about(t2m):
    warnings = t2m("a person walks forward " + "and on " * 130, seconds=1.0).warnings
    assert any("tokens, of which the text encoder reads" in warning for warning in warnings)


def test_foot_locking_is_a_switch(t2m):
    locked, free = (t2m(PROMPT, seconds=2.0, foot_lock=lock) for lock in (True, False))
    assert same(free.motion, free.raw[0])
    assert same(locked.raw[0], free.motion)
    assert not same(locked.motion, locked.raw[0])


def test_input_is_checked_before_weights_are_read(tiny_clips, tmp_path):
    broken = TextToMotion.from_pretrained(shutil.copytree(tiny_clips, tmp_path / "tiny"), device="cpu")
    for file in broken.bundle.path.glob("*.safetensors"):
        file.write_bytes(b"")
    with pytest.raises(InputError, match="the prompt is empty"):
        broken("", seconds=1.0)


def test_unknown_devices_are_refused(t2m):
    with pytest.raises(InputError, match="unknown device 'abacus'"):
        TextToMotion(t2m.bundle, "abacus")
    with pytest.raises(InputError, match="is not available on this machine"):
        TextToMotion(t2m.bundle, "cuda:99")


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))], ids=["deepcopy", "pickle"])
def test_a_copy_for_another_process_makes_the_same(t2m, copied, tmp_path, monkeypatch):
    made = t2m(PROMPT, seconds=2.0, seed=7)
    monkeypatch.chdir(tmp_path)
    again = copied(t2m)(PROMPT, seconds=2.0, seed=7)
    assert same(again.motion, made.motion)
    assert again.warnings == made.warnings


def test_a_pickle_holds_no_weights(t2m):
    t2m(PROMPT, seconds=2.0)
    assert len(pickle.dumps(t2m)) < 2000
