"""Forward kinematics of a BVH file, in its own unit and axes, onto our 22 joints."""

from collections.abc import Mapping

import numpy as np

from core.rotations import normalize, quat_from_axis_angle, quat_mul, quat_rotate
from motion.human.bvh_file import Bvh
from motion.human.motion import JOINTS, PARENTS
from motion.human.skeleton import MEAN_SKELETON

_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def t_pose_values(bvh: Bvh, pose_deg: Mapping[str, Mapping[str, float]]) -> np.ndarray:
    """Channel values (1,C) of a pose: rotations in degrees by joint and channel, the others zero; places as offsets."""
    values = np.zeros((1, bvh.values.shape[1]))
    for joint in bvh.joints:
        for column, channel in enumerate(joint.channels, start=joint.first):
            if channel.endswith("position"):
                values[0, column] = joint.offset["xyz".index(channel[0])]
            else:
                values[0, column] = pose_deg.get(joint.name, {}).get(channel, 0.0)
    return values


def bvh_pose(bvh: Bvh, values: np.ndarray, theirs: Mapping[str, str]) -> tuple[np.ndarray, np.ndarray]:
    """Places (N,22,3) and rotations against the file's zero pose (N,22,4) of our joints, for channel values (N,C).

    `theirs` names the file's joint for each of ours, some of the spine and the like left out: those lie between their
    neighbours, as in the mean skeleton, and turn with the one before them.
    """
    place, turn = _forward(bvh, values, set(theirs.values()))
    pos, quat = np.empty((len(values), len(JOINTS), 3)), np.empty((len(values), len(JOINTS), 4))
    for index, name in enumerate(JOINTS):
        if name in theirs:
            pos[:, index], quat[:, index] = place[theirs[name]], turn[theirs[name]]
    for index, name in enumerate(JOINTS):
        if name not in theirs:
            before = PARENTS[index]
            after, share = _next_known(index, theirs)
            quat[:, index] = quat[:, before]
            pos[:, index] = pos[:, before] + share * (pos[:, after] - pos[:, before])
    return pos, quat


def _forward(bvh: Bvh, values: np.ndarray, names: set[str]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Places (N,3) and rotations (N,4) of the joints `names` and those they hang on.

    A joint with position channels lies where they say, the others at their offset.
    """
    needed = {index for index, joint in enumerate(bvh.joints) if joint.name in names}
    for index in range(len(bvh.joints) - 1, 0, -1):
        if index in needed:
            needed.add(bvh.joints[index].parent)
    places: dict[str, np.ndarray] = {}
    turns: dict[str, np.ndarray] = {}
    for index in sorted(needed):
        joint = bvh.joints[index]
        place = np.tile(np.array(joint.offset), (len(values), 1))
        turn = np.tile(_IDENTITY, (len(values), 1))
        for column, channel in enumerate(joint.channels, start=joint.first):
            axis = "xyz".index(channel[0])
            if channel.endswith("position"):
                place[:, axis] = values[:, column]
            else:
                about = np.tile(np.eye(3)[axis], (len(values), 1))
                turn = quat_mul(turn, quat_from_axis_angle(about, np.radians(values[:, column])))
        if joint.parent >= 0:
            parent = bvh.joints[joint.parent].name
            place = places[parent] + quat_rotate(turns[parent], place)
            turn = normalize(quat_mul(turns[parent], turn))
        places[joint.name], turns[joint.name] = place, turn
    return places, turns


def _next_known(index: int, theirs: Mapping[str, str]) -> tuple[int, float]:
    """The first joint after `index` that the file has, and how far along the way to it `index` lies from its parent.

    Of joints at the end of a chain (the head), the parent itself.
    """
    lengths = np.linalg.norm(MEAN_SKELETON.offset_m, axis=1)
    way, after = lengths[index], index
    while JOINTS[after] not in theirs:
        children = [child for child, parent in enumerate(PARENTS) if parent == after]
        if not children:
            return PARENTS[index], 0.0
        after = children[0]
        way += lengths[after]
    return after, float(lengths[index] / way)
