"""Real takes of what is done off the feet: the way from a capture to a finished clip leaves them what they are."""

import pytest
import torch

from moveset.data import cmu, more_mocap, posture
from moveset.motion.cleanup import lock_feet
from moveset.motion.contacts import PLANTED, stands_on
from moveset.motion.features import get_codec
from moveset.motion.hold_root import hold_root
from moveset.motion.skeleton import HML22

TAKES = {
    "lying, getting up": ("cmu-more", "140_08"),
    "cartwheel": ("cmu-more", "49_06"),
    "sitting on the floor": ("more-mocap", "tilling-patch/itonic3_wd2_walktocrawl_1"),
    "jumping": ("more-mocap", "human-foot/wd2_101"),
    "climbing": ("cmu", "01_07"),
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
    off = ~stands_on(decoded.joints, HML22)
    # A quarter of a second before and after, feet come from where they were held.
    clear = torch.nn.functional.max_pool1d((~off).float()[None], 13, 1, 6)[0] == 0
    moved = (locked.joints - decoded.joints).norm(dim=-1).amax(dim=1)
    assert not clear.any() or moved[clear].max() < 0.02
    # Hips and all above them stay where they are, on the feet or not; a held root goes its own way off them.
    legs = [joint for joint, name in enumerate(HML22.joints) if name.endswith(("knee", "ankle", "foot"))]
    still = [joint for joint in range(len(HML22)) if joint not in legs]
    assert (locked.joints - decoded.joints)[:, still].norm(dim=-1).max() < 0.02
    held = codec.decode(hold_root(features, features[:, codec.groups["contacts"]] > PLANTED, codec))
    steps = (held.root - decoded.root).diff(dim=0).norm(dim=-1)[off[1:] & off[:-1]]
    assert (steps < 1e-5).all()


def test_hips_near_the_floor_do_not_stand():
    still = torch.zeros(3, 22, 3)
    still[:, [1, 2], 1] = torch.tensor([0.9, 0.38, 0.1])[:, None]
    assert stands_on(still, HML22).tolist() == [True, False, False]
