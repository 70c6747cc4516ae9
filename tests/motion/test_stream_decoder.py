"""What a stream gives out is its parts one after the other, can be copied and stored, and holds what it should."""

import json

import torch

from moveset.motion.clip import Motion
from moveset.motion.contacts import PLANTED
from moveset.motion.foot_lock import FootLock
from moveset.motion.hold_root import hold_root
from moveset.motion.incremental import IncrementalDecoder
from moveset.motion.native import NativeCodec
from moveset.motion.stream_decoder import StreamDecoder
from tests.motions import gait

CODEC, N = NativeCodec(), 28


def features(stretch: float = 1.1) -> torch.Tensor:
    """A walk of four segments whose root gets further than its feet carry it."""
    walk = gait(4 * N)
    return CODEC.encode(Motion(walk.rotations, walk.root * torch.tensor([1.0, 1.0, stretch]), walk.fps, walk.skeleton))


def same(a: Motion, b: Motion) -> bool:
    return torch.equal(a.root, b.root) and torch.equal(a.rotations, b.rotations)


def test_it_holds_the_root_then_decodes_then_locks_feet():
    made = StreamDecoder(CODEC, 0.3)
    decoder, feet = IncrementalDecoder(CODEC, 0.3), FootLock(CODEC.skeleton, CODEC.fps)
    for piece in features().split(N):
        planted = piece[:, CODEC.groups["contacts"]] > PLANTED
        assert planted.any()
        assert torch.equal(CODEC.planted(piece), planted)
        assert same(made(piece), feet(decoder(hold_root(piece, planted, CODEC)), planted))


def test_a_copy_and_a_stored_one_go_on_alike_and_do_not_disturb_it():
    pieces = features().split(N)
    made = StreamDecoder(CODEC, 0.3)
    made(pieces[0])
    copied, stored = made.copy(), StreamDecoder(CODEC, 0.3)
    stored.restore(json.loads(json.dumps(made.state())))
    ahead = [copied(piece) for piece in pieces[1:]]
    again = [made(piece) for piece in pieces[1:]]
    late = [stored(piece) for piece in pieces[1:]]
    assert all(same(a, b) and same(a, c) for a, b, c in zip(ahead, again, late, strict=True))


def test_who_goes_on_from_a_given_motion_starts_where_it_ends():
    given, rest = features()[: 2 * N], features()[2 * N :]
    made = StreamDecoder(CODEC, foot_lock=False)
    made.go_on_from(given, heading=0.5, x=3.0, z=-2.0)
    alone = StreamDecoder(CODEC, foot_lock=False)
    alone.go_on_from(given, heading=0.0, x=0.0, z=0.0)
    there, here = made(rest), alone(rest)
    turned = torch.tensor([[0.5]], dtype=torch.float64)
    x, z = here.root[:, :1], here.root[:, 2:]
    expected = torch.cat((x * turned.cos() + z * turned.sin() + 3.0, z * turned.cos() - x * turned.sin() - 2.0), dim=1)
    torch.testing.assert_close(there.root[:, [0, 2]], expected, atol=1e-9, rtol=0)


def test_who_goes_on_from_a_given_motion_has_the_feet_that_it_ends_on():
    given, rest = features()[: 2 * N], features()[2 * N :]
    made = StreamDecoder(CODEC, 0.3)
    made.go_on_from(given, heading=0.0, x=0.0, z=0.0)
    decoder, feet = IncrementalDecoder(CODEC, 0.3), FootLock(CODEC.skeleton, CODEC.fps)
    feet(decoder(given), CODEC.planted(given))
    for piece in rest.split(N):
        planted = CODEC.planted(piece)
        assert same(made(piece), feet(decoder(hold_root(piece, planted, CODEC)), planted))
    unlocked = FootLock(CODEC.skeleton, CODEC.fps)
    decoder = IncrementalDecoder(CODEC, 0.3)
    decoder(given)
    planted = CODEC.planted(rest[:N])
    made.go_on_from(given, heading=0.0, x=0.0, z=0.0)
    assert not same(made(rest[:N]), unlocked(decoder(hold_root(rest[:N], planted, CODEC)), planted))
