"""Real takes of what is done off the feet: the way from a capture to a finished clip leaves them what they are."""

import pytest
import torch

from moveset.data import cmu, more_mocap, posture
from moveset.motion.cleanup import lock_feet
from moveset.motion.contacts import PLANTED, stances, stands_on
from moveset.motion.features import get_codec
from moveset.motion.hold_root import hold_root
from moveset.motion.skeleton import HML22

TAKES = {
    "lying, getting up": ("cmu-more", "140_08"),
    "lying, feet under the floor": ("more-mocap", "ys2010/wd2_Physics_Raise01"),
    "kneeling": ("cmu-more", "23_03"),
    "cartwheel": ("cmu-more", "49_06"),
    "sitting on the floor": ("more-mocap", "tilling-patch/itonic3_wd2_walktocrawl_1"),
    "sitting on a stool": ("cmu", "13_01"),
    "jumping": ("more-mocap", "human-foot/wd2_101"),
    "climbing": ("cmu", "01_07"),
    "stepping up": ("cmu-more", "83_24"),
}


@pytest.mark.parametrize("kind", TAKES)
def test_who_is_not_on_the_feet_is_left_alone(real_data, kind):
    folder, name = TAKES[kind]
    if not (real_data / folder).is_dir():
        pytest.skip(f"no takes of {folder} here")
    reader = cmu if folder.startswith("cmu") else more_mocap
    ref = next(ref for ref in reader.list_takes(real_data / folder) if ref.name == name)
    if not ref.path.is_file():
        pytest.skip(f"no {ref.path.name} here")
    run = max(reader.read_take(ref).runs, key=len)
    motion = posture.on_floor(run.rotations, run.root, posture.floor_of(run.rotations, run.root))
    codec = get_codec("native")
    features = codec.encode(motion)
    decoded = codec.decode(features)
    assert (decoded.joints - motion.joints).norm(dim=-1).max() < 0.005
    locked = lock_feet(decoded)
    # Whoever sits, kneels, lies, stands on the hands, flies or is higher than the floor has no foot on it.
    carried = stands_on(decoded.joints, HML22)[:, None]
    free = far_from(stances(decoded.joints, decoded.fps, HML22) & carried, 5)
    assert free.sum() >= 4
    moved = locked.joints - decoded.joints
    deep = (-decoded.joints[..., 1].amin(dim=1)).clamp_min(0.0)  # floors of captures are not all level
    assert (moved[free].norm(dim=-1).amax(dim=1) < 0.02)[deep[free] == 0].all()
    assert (moved[free, :, 1].abs().amax(dim=1) < 2 * deep[free] + 0.02).all()
    assert locked.joints[free, :, 1].min() > -0.001
    # Hips and all above them stay where they are, on the feet or not; a held root goes its own way off them.
    legs = [joint for joint, name in enumerate(HML22.joints) if name.endswith(("knee", "ankle", "foot"))]
    arms = [joint for joint, name in enumerate(HML22.joints) if name.endswith(("elbow", "wrist"))]
    trunk = [joint for joint in range(len(HML22)) if joint not in (*legs, *arms)]
    assert (moved[:, trunk].norm(dim=-1).amax(dim=1) < 1.5 * deep + 0.02).all()
    # Elbows bend where arms are in the floor.
    assert (moved[:, arms].norm(dim=-1).amax(dim=1) < 2.5 * deep + 0.02).all()
    contacts = features[:, codec.groups["contacts"]] > PLANTED
    held = codec.decode(hold_root(features, contacts, codec))
    free = far_from(contacts & carried, 2)
    assert free.sum() >= 4
    assert (held.root - decoded.root).diff(dim=0).norm(dim=-1)[free[1:] & free[:-1]].max() < 1e-5


def far_from(planted, margin):
    """(F,) bool: no foot (F, 4) is planted within so many frames, in which it comes from where it is held."""
    near = torch.nn.functional.max_pool1d(planted.any(dim=1).float()[None], 2 * margin + 1, 1, margin)[0]
    return near == 0


def test_hips_near_the_floor_do_not_stand():
    still = torch.zeros(3, 22, 3)
    still[:, [1, 2], 1] = torch.tensor([0.9, 0.38, 0.1])[:, None]
    assert stands_on(still, HML22).tolist() == [True, False, False]
