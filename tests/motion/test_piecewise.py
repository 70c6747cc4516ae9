"""What decoding piece by piece asks of any codec, whatever its axes, units and headings."""

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.features import get_codec
from moveset.motion.hold_root import hold_root
from moveset.motion.stream_decoder import StreamDecoder
from tests.motions import wander
from tests.synthetic import synthetic_motion

CODECS = ("native", "hml", "kit")


def features(name, frames=84):
    """Features of somebody who wanders about, float64."""
    codec = get_codec(name)
    motion = wander(frames + 1, 3, codec.skeleton, turn=0.7)
    rows = codec.encode(motion) if name == "native" else codec.encode_world([motion.joints])[0]
    return codec, rows.double()[:frames]


@pytest.mark.parametrize("name", CODECS)
def test_the_root_path_is_that_of_the_motion(name):
    codec, rows = features(name)
    heading, root = codec.root_path(rows)
    joints = codec.joints(rows) * (torch.tensor([-1.0, 1.0, 1.0]) if name == "kit" else torch.ones(3))
    torch.testing.assert_close(root, joints[:, 0], atol=1e-9, rtol=0)
    # Seen from the heading, the hips are where the features' own columns have them.
    about = rotations.rotate(rotations.yaw(-heading), joints[:, 1] - root)
    columns = codec.groups["positions"]
    own = rows[:, columns.start : columns.start + 3] * (0.001 if name == "kit" else 1.0)
    own = own * (torch.tensor([-1.0, 1.0, 1.0]) if name == "kit" else torch.ones(3))
    torch.testing.assert_close(about[:, [0, 2]], own[:, [0, 2]], atol=2e-2 if name == "native" else 1e-6, rtol=0)


@pytest.mark.parametrize("name", CODECS)
def test_steps_are_changed_in_the_world(name):
    codec, rows = features(name)
    change = 0.02 * torch.randn(len(rows) - 1, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    moved = codec.with_steps(rows, change)
    extra = codec.root_path(moved)[1].diff(dim=0) - codec.root_path(rows)[1].diff(dim=0)
    torch.testing.assert_close(extra[:, [0, 2]], change, atol=1e-9, rtol=0)
    assert not extra[:, 1].any()


@pytest.mark.parametrize("name", CODECS)
def test_pieces_go_on_as_the_whole_does(name):
    codec, rows = features(name)
    decoder, pieces = StreamDecoder(codec, foot_lock=False), rows.split(28)
    made = [decoder(piece) for piece in pieces]
    _, root = codec.root_path(rows)
    torch.testing.assert_close(torch.cat([piece.root for piece in made]), root, atol=1e-6, rtol=0)
    whole = codec.decode(rows)
    apart = (torch.cat([piece.joints for piece in made]) - whole.joints).norm(dim=-1)
    # Positions alone do not say how limbs are twisted, which frames around decide.
    assert apart.mean() < 2e-3


@pytest.mark.parametrize("name", ["native", "hml"])
def test_who_stands_is_held(name):
    codec = get_codec(name)
    standing = synthetic_motion("bow", 60)
    rows = codec.encode(standing).double()
    planted = codec.planted(rows)
    assert planted.float().mean() > 0.9
    drifting = codec.with_steps(rows, torch.full((len(rows) - 1, 2), 0.005, dtype=torch.float64))
    held = hold_root(drifting, codec.planted(drifting), codec)
    drift = [codec.root_path(x)[1][-1].norm() for x in (drifting, held)]
    assert drift[1] - root_end(codec, rows) < 0.3 * (drift[0] - root_end(codec, rows))


def root_end(codec, rows):
    return codec.root_path(rows)[1][-1].norm()
