"""Made-up recordings: a person who moves at random, and the BVH file that any skeleton makes of it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from motion.human.motion import JOINTS, PARENTS
from motion.human.skeleton import MEAN_SKELETON

ROTATIONS = ("Zrotation", "Yrotation", "Xrotation")
# Our axes (x forward, y left, z up) to those of a file with y up that faces z.
Y_UP = Rotation.from_matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
Z_UP = Rotation.identity()


@dataclass
class Person:
    """Root place (N,3) m and turns of every joint against its parent, in the axes of the T-pose (N of them, 22)."""

    root: np.ndarray
    local: list[list[Rotation]]

    def segments(self) -> list[list[Rotation]]:
        """The rotation of every segment, frame by frame."""
        frames = []
        for local in self.local:
            turns: list[Rotation] = []
            for joint, parent in enumerate(PARENTS):
                turns.append(local[joint] if parent < 0 else turns[parent] * local[joint])
            frames.append(turns)
        return frames

    def places(self) -> np.ndarray:
        """Joints (N,22,3): forward kinematics with scipy's rotations."""
        places = np.zeros((len(self.root), len(JOINTS), 3))
        for frame, turns in enumerate(self.segments()):
            places[frame, 0] = self.root[frame]
            for joint, parent in enumerate(PARENTS[1:], start=1):
                offset = turns[parent].apply(MEAN_SKELETON.offset_m[joint].copy())
                places[frame, joint] = places[frame, parent] + offset
        return places


def person(num_frames: int = 6, bend_rad: float = 0.4, seed: int = 1, stiff: Collection[str] = ()) -> Person:
    """Somebody upright who walks slowly, turns, and bends every joint at random but the `stiff` ones."""
    rng = np.random.default_rng(seed)
    root = np.array([0.3, -0.2, 0.94]) + np.linspace(0.0, 0.05, num_frames)[:, None] * [1.0, 0.5, 0.0]
    local = [[Rotation.from_rotvec(rng.uniform(-bend_rad, bend_rad, 3)) for _ in JOINTS] for _ in range(num_frames)]
    for frame in local:
        for name in stiff:
            frame[JOINTS.index(name)] = Rotation.identity()
        frame[0] = Rotation.from_euler("z", 0.7) * Rotation.from_rotvec(rng.uniform(-0.1, 0.1, 3))
    return Person(root, local)


def standing(num_frames: int = 4, height: float = 0.9381) -> Person:
    """The T-pose on the ground (the mean skeleton's pelvis is 0.938 m above its soles)."""
    return Person(np.tile([0.0, 0.0, height], (num_frames, 1)), [[Rotation.identity()] * len(JOINTS)] * num_frames)


@dataclass
class Rig:
    """How a file's skeleton is built. `names`: ours to theirs; `frames`: how a joint's own axes stand in the T-pose,
    expressed in ours, the others as the body's; `unit_m`, the file's axes and the order of its rotation channels."""

    names: Mapping[str, str]
    frames: Mapping[str, Rotation] = field(default_factory=dict)
    unit_m: float = 0.01
    axes: Rotation = Y_UP
    order: Sequence[str] = ROTATIONS
    frame_time: str = "0.033333"
    scale: float = 1.0

    def frame(self, joint: int) -> Rotation:
        """The joint's own axes in the T-pose, from the file's axes."""
        own = self.frames.get(JOINTS[joint], Rotation.identity())
        return self.axes * own * self.axes.inv()


def bvh_text(who: Person, rig: Rig) -> str:
    """The recording of `who` as a BVH file. End sites of names like LeftAnkle/end stand for our feet."""
    known = [i for i, name in enumerate(JOINTS) if name in rig.names]
    parents = {i: _known_parent(i, known) for i in known}
    joints = [i for i in known if not rig.names[JOINTS[i]].endswith("/end")]
    places = MEAN_SKELETON.t_pose_m() * rig.scale
    lines = ["HIERARCHY"]
    _write(0, places, rig, parents, lines, "ROOT")
    lines += ["MOTION", f"Frames: {len(who.root)}", f"Frame Time: {rig.frame_time}"]
    order = _written_order(0, parents, joints)
    for root, turns in zip(who.root, who.segments(), strict=True):
        world = {i: rig.axes * turns[i] * rig.axes.inv() * rig.frame(i) for i in joints}
        values = list(rig.axes.apply(root * rig.scale) / rig.unit_m)
        for i in order:
            local = world[i] if parents[i] < 0 else world[parents[i]].inv() * world[i]
            axes = "".join(name[0] for name in rig.order)
            values += list(local.as_euler(axes, degrees=True))
        lines.append(" ".join(f"{value:.6f}" for value in values))
    return "\n".join(lines) + "\n"


def _known_parent(index: int, known: Sequence[int]) -> int:
    parent = PARENTS[index]
    while parent >= 0 and parent not in known:
        parent = PARENTS[parent]
    return parent


def _written_order(index: int, parents: Mapping[int, int], joints: Sequence[int]) -> list[int]:
    children = [i for i in joints if parents[i] == index]
    return [index, *(i for child in children for i in _written_order(child, parents, joints))]


def _write(index: int, places: np.ndarray, rig: Rig, parents: Mapping[int, int], lines: list[str], word: str) -> None:
    parent = parents[index]
    offset = np.zeros(3)
    if parent >= 0:
        offset = rig.frame(parent).inv().apply(rig.axes.apply(places[index] - places[parent])) / rig.unit_m
    name = rig.names[JOINTS[index]]
    place = "Xposition Yposition Zposition " if parent < 0 else ""
    lines += [f"{word} {name}" if not name.endswith("/end") else "End Site", "{"]
    lines.append("OFFSET " + " ".join(f"{x:.6f}" for x in offset))
    children = [i for i, p in parents.items() if p == index]
    if not name.endswith("/end"):
        lines.append(f"CHANNELS {6 if place else 3} {place}{' '.join(rig.order)}")
        for child in children:
            _write(child, places, rig, parents, lines, "JOINT")
        if not children:
            lines += ["End Site", "{", "OFFSET 0 0 0", "}"]
    lines.append("}")
