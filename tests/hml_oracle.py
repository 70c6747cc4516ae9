"""HumanML3D's features a second time: numpy, quaternions as w, x, y, z, one frame and one bone at a time."""

import math

import numpy as np

UP, FRONT = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


def cross(u, v):
    return np.array((u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]))


def q_mul(a, b):
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + bw * ax + ay * bz - az * by,
        aw * by + bw * ay + az * bx - ax * bz,
        aw * bz + bw * az + ax * by - ay * bx,
    )


def q_inv(q):
    return (q[0], -q[1], -q[2], -q[3])


def q_turn(q, v):
    return np.array(q_mul(q_mul(q, (0.0, v[0], v[1], v[2])), q_inv(q))[1:])


def q_arc(u, v):
    w = math.sqrt((u @ u) * (v @ v)) + u @ v
    q = (w, *cross(u, v))
    size = math.sqrt(sum(c * c for c in q))
    return tuple(c / size for c in q)


def q_matrix(q):
    return np.stack([q_turn(q, e) for e in np.eye(3)], axis=1)


def unit(v):
    return v / math.sqrt(v @ v)


def inverse_kinematics(convention, joints, smooth):
    """Local quaternions (T, J, 4) of positions; the root's turn to +Z at index 0, frame 0 of it overwritten."""
    from scipy.ndimage import gaussian_filter1d

    frames, count = joints.shape[:2]
    hip_r, hip_l, shoulder_r, shoulder_l = convention.face
    forward = np.zeros((frames, 3))
    for t in range(frames):
        # The slip of the published code: its hips arrive in the other order than its shoulders.
        across = joints[t, hip_l] - joints[t, hip_r] + joints[t, shoulder_r] - joints[t, shoulder_l]
        forward[t] = cross(UP, unit(across))
    if smooth:
        forward = gaussian_filter1d(forward, 20, axis=0, mode="nearest")
    out = np.zeros((frames, count, 4))
    out[:, :, 0] = 1.0
    directions = convention.directions.numpy()
    for t in range(frames):
        root = q_arc(unit(forward[t]), FRONT) if t > 0 else (1.0, 0.0, 0.0, 0.0)
        out[t, 0] = root
        for chain in convention.chains:
            turn = root
            for k in range(1, len(chain)):
                bone = unit(joints[t, chain[k]] - joints[t, chain[k - 1]])
                local = q_mul(q_inv(turn), q_arc(directions[chain[k]], bone))
                out[t, chain[k]] = local
                turn = q_mul(turn, local)
    return out


def reposed(convention, joints, lengths):
    """``joints`` (T, J, 3) on a body with the given bone lengths, by inverse and forward kinematics."""
    directions = convention.directions.numpy()
    parents = convention.skeleton.parents
    legs = convention.legs
    own = sum(np.linalg.norm(joints[0, j] - joints[0, parents[j]]) for j in legs)
    wanted = sum(np.abs(directions[j] * lengths[j]).max() for j in legs)
    quaternions = inverse_kinematics(convention, joints, smooth=False)
    out = np.zeros_like(joints)
    for t in range(len(joints)):
        out[t, 0] = joints[t, 0] * (wanted / own)
        for chain in convention.chains:
            turn = quaternions[t, 0]
            for k in range(1, len(chain)):
                turn = q_mul(turn, quaternions[t, chain[k]])
                out[t, chain[k]] = out[t, chain[k - 1]] + q_turn(turn, directions[chain[k]] * lengths[chain[k]])
    return out


def extract(convention, joints, lengths, uniform=True):
    """The features (T - 1, D) of ``joints`` in the dataset's unit, and the positions they describe."""
    if uniform:
        joints = reposed(convention, joints, lengths)
    joints = joints - UP * joints[:, :, 1].min()
    joints = joints - joints[0, 0] * (1 - UP)
    hip_r, hip_l, shoulder_r, shoulder_l = convention.face
    across = joints[0, hip_r] - joints[0, hip_l] + joints[0, shoulder_r] - joints[0, shoulder_l]
    start = q_arc(unit(cross(UP, unit(across))), FRONT)
    joints = np.array([[q_turn(start, p) for p in frame] for frame in joints])

    quaternions = inverse_kinematics(convention, joints, smooth=True)
    rows = []
    for t in range(len(joints) - 1):
        q, q_next, root = quaternions[t, 0], quaternions[t + 1, 0], joints[t, 0]
        step = joints[t + 1] - joints[t]
        planar = q_turn(q_next, step[0])
        row = [np.arcsin(q_mul(q_next, q_inv(q))[2]), planar[0], planar[2], root[1]]
        for p in joints[t, 1:]:
            row += list(q_turn(q, p - root * (1 - UP)))
        for local in quaternions[t, 1:]:
            row += list(q_matrix(local)[:, 0]) + list(q_matrix(local)[:, 1])
        for v in step:
            row += list(q_turn(q, v))
        row += [float((step[j] ** 2).sum() < convention.contact) for j in convention.feet]
        rows.append(row)
    return np.array(rows), joints


def recover(convention, features):
    """Positions (F, J, 3) from the root and position columns, frame by frame."""
    count = len(convention.skeleton.parents)
    angle, root, out = 0.0, np.zeros(3), []
    for t, row in enumerate(features):
        if t > 0:
            angle += features[t - 1, 0]
            back = (math.cos(angle), 0.0, -math.sin(angle), 0.0)
            root = root + q_turn(back, np.array([features[t - 1, 1], 0.0, features[t - 1, 2]]))
        back = (math.cos(angle), 0.0, -math.sin(angle), 0.0)
        frame = [root + UP * row[3]]
        frame += [q_turn(back, row[4 + 3 * j : 7 + 3 * j]) + root for j in range(count - 1)]
        out.append(frame)
    return np.array(out)
