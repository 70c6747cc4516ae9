"""A HumanML3D or KIT-ML folder with motions made from formulas, for training tests."""

from pathlib import Path

import numpy as np
import torch

from moveset.data.humanml3d import HUMANML3D, Layout
from moveset.motion.features import Normalizer, get_codec
from tests.synthetic import synthetic_motion

TEXT = "a person walks forward.#a/DET person/NOUN walk/VERB forward/ADV#0.0#0.0"
PART = "a person turns around.#a/DET person/NOUN turn/VERB around/ADV#1.0#4.0"


def write_folder(path: Path, layout: Layout = HUMANML3D) -> Path:
    """Splits of 6, 2 and 1 motions; of "000001" a part has a sentence of its own, "M000002" is a mirrored motion and
    "short" is too short to be used."""
    lengths = {"000001": 120, "000002": 64, "M000002": 64, "long": 199, "short": layout.shortest - 1, "e": 90}
    lengths |= {"val1": 80, "val2": layout.shortest, "test1": 70}
    for part in ("new_joint_vecs", "texts"):
        (path / part).mkdir(parents=True)
    codec, made = get_codec(layout.codec), []
    for k, (name, frames) in enumerate(lengths.items()):
        if layout is HUMANML3D:
            features = codec.encode(synthetic_motion("walk", frames + 1, seed=k))
        else:
            features = torch.randn(frames, layout.features, generator=torch.Generator().manual_seed(k))
        made.append(features)
        np.save(path / "new_joint_vecs" / f"{name}.npy", features.numpy())
        lines = [TEXT.replace("a person", "the person"), TEXT, *([PART] if name == "000001" else [])]
        (path / "texts" / f"{name}.txt").write_text("\n".join(lines) + "\n")
    statistics = Normalizer.fit(made, codec.groups)
    np.save(path / "Mean.npy", statistics.mean.numpy())
    np.save(path / "Std.npy", statistics.std.numpy())
    names = list(lengths)
    for split, chosen in (("train", names[:6]), ("val", names[6:8]), ("test", names[8:])):
        (path / f"{split}.txt").write_text("\n".join(chosen) + "\n")
    return path
