"""Packed quaternions: small, close, and safe for any bits."""

import torch

from moveset.data.quantize import pack, unpack
from moveset.motion import rotations

HALF = 0.5


def random_rotations(count: int, seed: int) -> torch.Tensor:
    return rotations.normalize(torch.randn(count, 4, generator=torch.Generator().manual_seed(seed)))


def error(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return rotations.angle(rotations.mul(rotations.inv(a.double()), b.double()))


def test_error_is_below_the_promise():
    q = random_rotations(50_000, 0)
    assert error(q, unpack(pack(q))).max() < 1.5e-4


def test_corner_cases():
    q = torch.cat((torch.eye(4), -torch.eye(4), torch.full((1, 4), HALF), torch.tensor([[HALF, -HALF, HALF, -HALF]])))
    assert error(q, unpack(pack(q))).max() < 1.5e-4
    near = rotations.normalize(torch.tensor([[1.0, 1.0 - 1e-7, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0]]))
    assert error(near, unpack(pack(near))).max() < 1.5e-4


def test_packing_again_changes_nothing():
    packed = pack(random_rotations(5000, 3))
    again = pack(unpack(packed))
    assert error(unpack(packed), unpack(again)).max() < 1e-4
    assert packed.dtype == torch.int16
    assert packed.shape == (5000, 3)


def test_any_bits_are_a_rotation():
    bits = torch.randint(-32768, 32768, (2000, 3), generator=torch.Generator().manual_seed(0)).to(torch.int16)
    assert torch.allclose(unpack(bits).norm(dim=-1), torch.ones(2000), atol=1e-6)
