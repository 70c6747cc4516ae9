"""Streams that run beside a training: what their rows are told, and when they give way."""

from dataclasses import replace

import pytest
import torch

from moveset.data.segments import SegmentBatch
from moveset.diffusion.phases import PhaseGrid
from moveset.errors import InputError
from moveset.training import rollout
from moveset.training.rollout import Rollout

BATCH, FRAMES, FEATURES = 6, 4, 3
W = torch.arange(BATCH) / 10
TURN = torch.linspace(0.1, 0.6, BATCH)
ONE, TWO = PhaseGrid(10, 1), PhaseGrid(10, 2)


def takes(step, partial=()):
    """Segments whose numbers tell step and row: clean 100 step + row, previous the same and a half."""
    rows = 100.0 * step + torch.arange(BATCH)[:, None, None].expand(BATCH, FRAMES, FEATURES)
    valid = torch.ones(BATCH, FRAMES, dtype=torch.bool)
    valid[list(partial), -1] = False
    captions = [f"take {step} {row}" for row in range(BATCH)]
    index = torch.ones(BATCH, dtype=torch.long)
    begun, turned = torch.ones(BATCH, dtype=torch.bool), 10.0 * step + torch.arange(BATCH)
    sides = turned[:, None].expand(BATCH, 3)
    return SegmentBatch(rows, valid, rows + 0.5, rows, index, begun, turned, sides, captions, list(captions))


def lasting(monkeypatch, segments, staying=0.5):
    monkeypatch.setattr(rollout, "SEGMENTS", segments)
    monkeypatch.setattr(rollout, "STAYING", staying)


def test_a_stream_is_told_what_was_made_of_it_and_takes_are_left_alone(monkeypatch):
    lasting(monkeypatch, 1e9)
    own, draws = Rollout(1 / 3, BATCH, ONE), torch.Generator().manual_seed(0)
    assert own.rows.tolist() == [0, 3]
    first, w = own.tell(takes(1), W, draws)
    assert first.captions[3] == "take 1 1"  # the second stream begins as the second take
    kept = w[own.rows]
    made = torch.randn(BATCH, FRAMES, FEATURES, generator=draws)
    own.go_on(made, made, TURN)
    batch, w = own.tell(takes(2), W + 1, draws)
    plain = takes(2)
    for row in range(BATCH):
        if row in (0, 3):
            assert torch.equal(batch.previous[row], made[row])
            assert torch.equal(batch.clean[row], first.clean[row])
            assert (batch.captions[row], int(batch.index[row])) == (first.captions[row], 2)
            assert torch.equal(batch.sides[row], first.sides[row])
        else:
            assert torch.equal(batch.previous[row], plain.previous[row])
            assert torch.equal(batch.clean[row], plain.clean[row])
            assert (batch.captions[row], int(batch.index[row])) == (plain.captions[row], 1)
            assert w[row] == W[row] + 1
    assert torch.equal(w[own.rows], kept)


def test_a_new_sentence_is_said_to_a_stream_or_begins_another(monkeypatch):
    for staying in (0.0, 1.0):
        lasting(monkeypatch, 1, staying)
        own, draws = Rollout(0.5, BATCH, ONE), torch.Generator().manual_seed(0)
        own.tell(takes(1), W, draws)
        own.go_on(*torch.full((2, BATCH, FRAMES, FEATURES), -1.0), TURN)
        batch, _ = own.tell(takes(2), W, draws)
        assert [batch.captions[row] for row in own.rows] == ["take 2 0", "take 2 1", "take 2 2"]
        assert torch.equal(batch.clean[own.rows], takes(2).clean[:3])
        assert torch.equal(batch.sides[own.rows], takes(2).sides[:3])
        expected = torch.full((3, FRAMES, FEATURES), -1.0) if staying else takes(2).previous[:3]
        assert torch.equal(batch.previous[own.rows], expected)


def test_a_stream_knows_how_far_it_has_turned_since_it_was_told(monkeypatch):
    """What began as a take has turned as far as that; what is said to a running stream begins at nought."""
    for staying in (0.0, 1.0):
        lasting(monkeypatch, 1e9, staying)
        own, draws = Rollout(1 / 3, BATCH, ONE), torch.Generator().manual_seed(0)
        for step in range(3):
            batch, _ = own.tell(takes(step), W, draws)
            torch.testing.assert_close(batch.turned[own.rows], torch.tensor([0.0, 1.0]) + step * TURN[own.rows])
            assert torch.equal(batch.turned[[1, 2, 4, 5]], takes(step).turned[[1, 2, 4, 5]])
            own.go_on(*torch.zeros(2, BATCH, FRAMES, FEATURES), TURN)
        lasting(monkeypatch, 1, staying)
        batch, _ = own.tell(takes(3), W, draws)
        assert batch.turned[own.rows].tolist() == ([0, 0] if staying else [30, 31])
        # Who is told nothing of it is told nothing of it later.
        own.tell(replace(takes(4), turned=torch.full((BATCH,), torch.nan)), W, draws)
        own.go_on(*torch.zeros(2, BATCH, FRAMES, FEATURES), TURN)
        lasting(monkeypatch, 1e9)
        assert own.tell(takes(5), W, draws)[0].turned[own.rows].isnan().all()


def test_a_segment_of_two_phases_takes_two_steps_and_goes_on_from_where_it_landed(monkeypatch):
    lasting(monkeypatch, 1e9)
    own, draws = Rollout(1 / 3, BATCH, TWO), torch.Generator().manual_seed(0)
    points, noisy = torch.full((BATCH,), 2), torch.zeros(BATCH, FRAMES, FEATURES)
    made, landed = torch.randn((2, 4, BATCH, FRAMES, FEATURES), generator=draws)
    a, b = own.rows.tolist()
    told = []
    for step in range(4):
        point_B = own.place(points)
        batch, _ = own.tell(takes(step), W, draws)
        told.append(batch.previous)
        # They take turns: one begins where the other is in the middle.
        high, low = (a, b) if step % 2 == 0 else (b, a)
        assert (int(point_B[high]), int(point_B[low])) == (9, 4)
        assert batch.index[[a, b]].tolist() == [1 + step // 2, 1 + (step + 1) // 2]
        z = own.enter(noisy)
        assert torch.equal(z[low], landed[step - 1][low] if step else noisy[low])
        assert not z[[row for row in range(BATCH) if row != low]].any()
        own.go_on(made[step], landed[step], TURN)
    assert torch.equal(told[0][a], told[1][a])
    assert torch.equal(told[2][a], told[3][a])
    assert torch.equal(told[2][a], made[1][a])
    assert torch.equal(told[1][b], made[0][b])
    assert torch.equal(told[3][b], made[2][b])


def test_the_noise_that_a_segment_began_with_is_kept_until_its_end(monkeypatch):
    lasting(monkeypatch, 1e9)
    own, draws = Rollout(1 / 3, BATCH, TWO), torch.Generator().manual_seed(0)
    noises = torch.randn((4, BATCH, FRAMES, FEATURES), generator=draws)
    a, b = own.rows.tolist()
    seen = []
    for step in range(4):
        own.tell(takes(step), W, draws)
        seen.append(own.began_with(noises[step]))
        own.go_on(noises[step], noises[step], TURN)
    others = [row for row in range(BATCH) if row not in (a, b)]
    assert torch.equal(torch.stack(seen)[:, others], noises[:, others])
    # The first segment of the second stream begins in its middle, where a take's segment is.
    for row, began in ((a, (0, 0, 2, 2)), (b, (0, 1, 1, 3))):
        assert torch.equal(torch.stack(seen)[:, row], noises[list(began), row])


def test_a_segment_is_finished_before_its_stream_gives_way(monkeypatch):
    lasting(monkeypatch, 1)
    own, draws = Rollout(0.5, BATCH, TWO), torch.Generator().manual_seed(0)
    said = []
    for step in range(4):
        captions = own.tell(takes(step), W, draws)[0].captions
        said.append((captions[0], captions[2]))
        own.go_on(*torch.zeros(2, BATCH, FRAMES, FEATURES), TURN)
    # What one said in its middle it goes on saying; the other, a step ahead, is told something else.
    assert [first for first, _ in said] == ["take 0 0", "take 0 0", "take 2 0", "take 2 0"]
    assert [second for _, second in said] == ["take 0 1", "take 1 1", "take 1 1", "take 3 1"]


def test_a_stream_lasts_as_long_as_it_says(monkeypatch):
    lasting(monkeypatch, 8)
    own, draws, ended = Rollout(0.5, BATCH, ONE), torch.Generator().manual_seed(0), 0
    own.tell(takes(0), W, draws)
    for step in range(1, 2001):
        own.go_on(*torch.zeros(2, BATCH, FRAMES, FEATURES), TURN)
        batch, _ = own.tell(takes(step), W, draws)
        ended += sum(batch.captions[row].startswith(f"take {step} ") for row in own.rows)
    assert abs(ended / 6000 - 1 / 8) < 0.015


def test_examples_are_whole_segments_and_what_a_stream_makes_is_judged_whole():
    own, draws = Rollout(0.5, BATCH, ONE), torch.Generator().manual_seed(0)
    batch, _ = own.tell(takes(1, partial=(0, 2, 3)), W, draws)
    assert [batch.captions[row] for row in own.rows] == ["take 1 1", "take 1 4", "take 1 5"]
    assert batch.valid[own.rows].all()
    assert not batch.valid[3].all()
    # Nothing but fragments: they have to do.
    Rollout(0.5, BATCH, ONE).tell(takes(1, partial=range(BATCH)), W, draws)


def test_no_share_is_no_stream_and_a_share_of_none_is_refused():
    own = Rollout(0.0, BATCH, ONE)
    assert own.count == len(own.rows) == 0
    assert own.state() == {}
    with pytest.raises(InputError, match="not one row"):
        Rollout(0.01, BATCH, ONE)


def test_other_streams_than_those_saved_begin_anew():
    one, draws = Rollout(0.5, BATCH, ONE), torch.Generator().manual_seed(0)
    one.tell(takes(1), W, draws)
    state, cpu = one.state(), torch.device("cpu")
    for share in (0.0, 1.0):
        other = Rollout(share, BATCH, ONE)
        other.load_state(state, cpu)
        assert other.state() == {}
    # In the middle of a segment of more phases, and as saved when there was one phase only.
    for wrong in (state | {"phase": state["phase"] + 1}, {name: state[name] for name in state if name != "phase"}):
        one = Rollout(0.5, BATCH, ONE)
        one.load_state(wrong, cpu)
        assert one.state() == {}


def test_state_comes_back_to_the_last_stream():
    one, draws = Rollout(0.5, BATCH, ONE), torch.Generator().manual_seed(0)
    one.tell(takes(1), W, draws)
    one.go_on(*torch.randn(2, BATCH, FRAMES, FEATURES), TURN)
    other = Rollout(0.5, BATCH, ONE)
    other.load_state(one.state(), torch.device("cpu"))
    for step in (2, 3):
        seeds = [torch.Generator().manual_seed(step) for _ in range(2)]
        (a, wa), (b, wb) = (own.tell(takes(step), W, seed) for own, seed in zip((one, other), seeds, strict=True))
        assert torch.equal(a.previous, b.previous)
        assert torch.equal(a.clean, b.clean)
        assert torch.equal(wa, wb)
        assert a.captions == b.captions
