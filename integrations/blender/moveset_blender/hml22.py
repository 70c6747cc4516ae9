"""The skeleton of moveset's models and of .mvst files, which name no joints: SMPL's first 22, T pose, metres, Y up."""

import numpy as np

from .take import Skeleton

# fmt: off
_JOINTS = (
    ("pelvis", -1, (0.0, 0.0, 0.0)),
    ("left_hip", 0, (0.0607728, -0.0852952, -0.0191914)),
    ("right_hip", 0, (-0.0607728, -0.0852952, -0.0191914)),
    ("spine1", 0, (0.0, 0.1263072, -0.0368396)),
    ("left_knee", 1, (0.0, -0.3919050, 0.0)),
    ("right_knee", 2, (0.0, -0.3919050, 0.0)),
    ("spine2", 3, (0.0, 0.1405724, 0.0272538)),
    ("left_ankle", 4, (0.0, -0.4290350, 0.0)),
    ("right_ankle", 5, (0.0, -0.4290350, 0.0)),
    ("spine3", 6, (0.0, 0.0572884, 0.0028644)),
    ("left_foot", 7, (0.0, -0.0643004, 0.1315235)),
    ("right_foot", 8, (0.0, -0.0643004, 0.1315235)),
    ("neck", 9, (0.0, 0.2168846, -0.0328613)),
    ("left_collar", 9, (0.0773399, 0.1153067, -0.0210927)),
    ("right_collar", 9, (-0.0773399, 0.1153067, -0.0210927)),
    ("head", 12, (0.0, 0.0897796, 0.0505655)),
    ("left_shoulder", 13, (0.1184140, 0.0445644, -0.0140060)),
    ("right_shoulder", 14, (-0.1184140, 0.0445644, -0.0140060)),
    ("left_elbow", 16, (0.2599650, 0.0, 0.0)),
    ("right_elbow", 17, (-0.2599650, 0.0, 0.0)),
    ("left_wrist", 18, (0.2680000, 0.0, 0.0)),
    ("right_wrist", 19, (-0.2680000, 0.0, 0.0)),
)
# fmt: on

HML22 = Skeleton(
    "hml22",
    tuple(name for name, _, _ in _JOINTS),
    tuple(parent for _, parent, _ in _JOINTS),
    np.array([offset for _, _, offset in _JOINTS]),
)
