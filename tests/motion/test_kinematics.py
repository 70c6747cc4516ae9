"""Forward kinematics by hand, by matrices, and back to local rotations."""

import torch

from moveset.motion import rotations
from moveset.motion.kinematics import fk, fk_matrices
from moveset.motion.skeleton import HML22, KIT21, Skeleton

ARM = Skeleton("arm", ("a", "b", "c"), (-1, 0, 1), torch.tensor([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]]))


def pose(*shape, skeleton, seed=0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    local = rotations.normalize(torch.randn(*shape, len(skeleton), 4, generator=generator, dtype=torch.float64))
    return local.to(dtype), torch.randn(*shape, 3, generator=generator, dtype=torch.float64).to(dtype)


def test_two_bones_by_hand():
    local = torch.stack((rotations.about("y", 90.0), rotations.about("z", 90.0), rotations.about("x", 45.0)))
    turned, placed = fk(local, torch.tensor([0.0, 1.0, 0.0]), ARM)
    # +X turned by 90 degrees about Y is -Z; there the second joint's Z axis is world X, so its bone points up.
    expected = torch.tensor([[0.0, 1.0, 0.0], [0.0, 1.0, -1.0], [0.0, 3.0, -1.0]])
    torch.testing.assert_close(placed, expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(turned[1], rotations.mul(local[0], local[1]))


def test_matrices_carry_gradient_to_every_joint_with_children():
    local, root = pose(3, skeleton=HML22)
    m = rotations.to_matrix(local).requires_grad_()
    fk_matrices(m, root, HML22).square().sum().backward()
    moved = m.grad.abs().amax(dim=(0, 2, 3)) > 0
    assert [bool(x) for x in moved] == [bool(children) for children in HML22.children]


def test_every_joint_follows_its_parent():
    local, root = pose(7, skeleton=KIT21)
    turned, placed = fk(local, root, KIT21)
    offsets = KIT21.offsets.double()
    torch.testing.assert_close(turned[:, 0], local[:, 0])
    torch.testing.assert_close(placed[:, 0], root)
    for j, p in enumerate(KIT21.parents[1:], start=1):
        torch.testing.assert_close(turned[:, j], rotations.mul(turned[:, p], local[:, j]))
        torch.testing.assert_close(placed[:, j], placed[:, p] + rotations.rotate(turned[:, p], offsets[j]))
