"""Sentences of several stages in streams: which segment is told what, alone, in groups and after a restart."""

import itertools

import pytest
import torch

from moveset.pipelines.stream_batch import StreamBatch
from moveset.pipelines.stream_settings import check_stream

WALK, BOW = "a person walks", "a person bows"
BOTH = "a person walks, then bows"
SEGMENT = 1.4  # seconds


def said(stream, count):
    return [segment.prompt for segment in itertools.islice(stream, count)]


@pytest.mark.parametrize("network", ["pcm-1", "rdm"])
def test_what_is_told_next_survives_a_restart(opened, network):
    through, again = (opened((BOTH, BOW), [4 * SEGMENT, 2 * SEGMENT], network=network) for _ in range(2))
    next(again)
    rest = opened(BOW, network=network).restore(again.state())
    next(through)
    for _ in range(5):
        assert torch.equal(next(through).motion.rotations, next(rest).motion.rotations)


def test_a_stream_does_one_after_the_other_and_holds_the_last(opened):
    assert said(opened(BOTH), 8) == [WALK] * 3 + [BOW] * 5
    assert said(opened(BOTH, loop=True), 8) == [WALK] * 3 + [BOW] * 3 + [WALK] * 2
    assert said(opened(BOTH, stages=False), 2) == [BOTH] * 2


def test_a_staged_sentence_equals_its_stages_as_prompts(opened):
    one, two = opened(BOTH, 6 * SEGMENT, seed=4), opened((WALK, BOW), 3 * SEGMENT, seed=4)
    for a, b in itertools.islice(zip(one, two, strict=True), 5):
        assert torch.equal(a.motion.rotations, b.motion.rotations)


def test_a_live_sentence_begins_with_its_first_stage(opened):
    stream = opened(WALK)
    said(stream, 5)
    assert stream.prompt(f"{BOW} and then waves") == 5 * 28
    assert said(stream, 5) == [BOW] * 3 + ["a person waves"] * 2
    assert stream.timeline.starts == (0, 8)


def test_a_group_does_what_a_stream_does(bundle, encoder, opened):
    settings = check_stream(bundle.config).settings
    batch = StreamBatch(bundle, settings, device="cpu", encoder=encoder)
    lane, lone = batch.open(BOTH, 7), opened(BOTH, seed=7)
    for _ in range(5):
        made, want = batch.step([lane])[0], next(lone)
        assert made.prompt == want.prompt
        assert torch.allclose(made.motion.joints, want.motion.joints, atol=1e-4)
    assert batch.prompt(lane, f"{BOW} before waving") == 5 * 28
    told = [batch.step([lane])[0].prompt for _ in range(4)]
    assert told == [BOW] * 3 + ["a person waving"]


def test_every_stage_is_warned_of(bundle, encoder, opened):
    batch = StreamBatch(bundle, check_stream(bundle.config).settings, device="cpu", encoder=encoder)
    text = f"{WALK}, then quarterly earnings of a bank"
    for warnings in (batch.warnings(batch.open(text, 0)), opened(text).warnings):
        assert [
            w for w in warnings if "unlike anything" in w and "quarterly" in w and "walks" not in w.split("unlike")[0]
        ]
    assert not batch.warnings(batch.open(BOTH, 0))
