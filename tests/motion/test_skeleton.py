"""The built-in skeletons are what their documentation says, and broken ones are refused."""

from dataclasses import replace

import pytest
import torch

from moveset.errors import InputError
from moveset.motion.skeleton import HML22, KIT21, Skeleton

BUILT_IN = [HML22, KIT21]


@pytest.mark.parametrize("skeleton", BUILT_IN, ids=lambda s: s.name)
def test_trees_are_consistent(skeleton):
    assert len(set(skeleton.joints)) == len(skeleton)
    assert skeleton.parents[0] == -1
    for j, children in enumerate(skeleton.children):
        assert all(skeleton.parents[c] == j for c in children)
        assert skeleton.index(skeleton.joints[j]) == j
    assert sorted(j for level in skeleton.levels for j in level) == list(range(len(skeleton)))
    for above, level in zip(skeleton.levels, skeleton.levels[1:], strict=False):
        assert all(skeleton.parents[j] in above for j in level)


@pytest.mark.parametrize("skeleton", BUILT_IN, ids=lambda s: s.name)
def test_rest_poses_are_symmetric_upright_and_face_front(skeleton):
    rest = skeleton.rest_positions
    mirrored = rest[list(skeleton.mirror_order)] * torch.tensor([-1.0, 1.0, 1.0])
    torch.testing.assert_close(mirrored, rest, atol=1e-6, rtol=0)
    for left, right in skeleton.pairs:
        assert skeleton.joints[left].startswith("left")
        assert skeleton.joints[right] == skeleton.joints[left].replace("left", "right")
        assert rest[left, 0] > 0 > rest[right, 0]
    assert rest[:, 1].argmax() == skeleton.index("head")
    left_ankle, left_toe, *_ = skeleton.feet
    assert rest[left_toe, 2] > rest[left_ankle, 2]
    assert rest[list(skeleton.feet), 1].max() < -0.4


def test_hml22_is_the_published_order_and_size():
    assert len(HML22) == 22
    assert HML22.parents == (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
    assert [HML22.joints[j] for j in HML22.feet] == ["left_ankle", "left_foot", "right_ankle", "right_foot"]
    leg = HML22.offsets[[4, 7]].norm(dim=-1).sum().item()
    assert leg == pytest.approx(0.82094, abs=1e-5)
    assert 1.5 < (HML22.rest_positions[15, 1] - HML22.rest_positions[10, 1]).item() < 1.7


@pytest.mark.parametrize(
    ("joints", "parents", "offsets", "message"),
    [
        (("a", "b"), (-1,), torch.zeros(2, 3), "2 joints, 1 parents"),
        (("a", "b"), (-1, 0), torch.zeros(2, 4), r"\(2, 4\)"),
        (("a", "b"), (-1, 1), torch.zeros(2, 3), "before their children"),
        (("a", "b"), (1, -1), torch.zeros(2, 3), "before their children"),
        (("a", "b"), (-1, -1), torch.zeros(2, 3), "joint 0 be the root"),
    ],
)
def test_broken_trees_are_refused(joints, parents, offsets, message):
    with pytest.raises(InputError, match=message):
        Skeleton("broken", joints, parents, offsets)


def test_unknown_joints_are_refused_with_the_known_ones():
    with pytest.raises(InputError, match=r"'hml22' has no joint 'right_hand'; it has pelvis, .*right_wrist"):
        HML22.index("right_hand")


def test_offsets_of_numpy_are_refused():
    with pytest.raises(InputError, match="needs its offsets as a tensor, not ndarray; convert"):
        Skeleton("s", ("root",), (-1,), torch.zeros(1, 3).numpy())


def test_a_body_is_its_joints_and_bones_whatever_it_is_called_and_in_whatever_order():
    tree = Skeleton("a", ("base", "arm", "leg", "hand"), (-1, 0, 0, 1), torch.eye(4)[:, :3])
    order = tree.order_in(Skeleton("b", ("base", "leg", "arm", "hand"), (-1, 0, 0, 2), torch.eye(4)[[0, 2, 1, 3], :3]))
    assert order == [0, 2, 1, 3]
    nudge, root = torch.zeros(4, 3), torch.zeros(4, 3)
    nudge[2, 0], root[0] = 9e-5, 1.0
    for offsets in (tree.offsets + nudge, tree.offsets + root):
        assert tree.order_in(replace(tree, name="b", offsets=offsets)) == [0, 1, 2, 3]
    for other in (
        replace(tree, offsets=tree.offsets + 2 * nudge),
        replace(tree, parents=(-1, 0, 1, 1)),
        replace(tree, joints=("base", "arm", "leg", "foot")),
        replace(tree, joints=("base", "arm", "leg", "arm")),
        Skeleton("a", tree.joints[:3], tree.parents[:3], tree.offsets[:3]),
    ):
        assert tree.order_in(other) is None
        assert other.order_in(tree) is None


def test_joints_of_one_name_are_told_apart_by_their_order():
    tree = Skeleton("a", ("base", "bone", "bone"), (-1, 0, 1), torch.eye(3))
    assert tree.order_in(replace(tree, name="b")) == [0, 1, 2]
    assert tree.order_in(Skeleton("b", ("bone", "base", "bone"), (-1, 0, 1), torch.eye(3))) is None
