"""The one form that every human motion takes before it is retargeted: 22 joints in the world, and the soles."""

from dataclasses import dataclass

import numpy as np

from core.errors import InputError

# The body joints of SMPL, in its order; each but the first after its parent.
JOINTS = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
SOLE_POINTS = ("heel", "ball_inner", "ball_outer", "toe")
ANKLES = (JOINTS.index("left_ankle"), JOINTS.index("right_ankle"))


@dataclass(frozen=True, eq=False)
class HumanMotion:
    """N frames at `fps`: world z up, metres.

    pos_w (N,22,3): joints in the order of JOINTS. quat_wxyz (N,22,4), unit: the rotation of each joint's segment from
    the T-pose that faces +x with the left arm along +y and the head along +z (identity: the segment is as in that
    pose), whatever the source's own axes. sole_w (N,2,4,3): SOLE_POINTS of the left and right foot, the lowest of the
    flesh (with shoes, if the source wears them). `source` and `license` as in a clip; `notes` say in a sentence each
    what was assumed or detected while reading (units, up-axis, body model). Raises InputError naming the field.
    """

    fps: float
    pos_w: np.ndarray
    quat_wxyz: np.ndarray
    sole_w: np.ndarray
    source: str = ""
    license: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shapes = {"pos_w": (len(JOINTS), 3), "quat_wxyz": (len(JOINTS), 4), "sole_w": (2, len(SOLE_POINTS), 3)}
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape[1:] != shape or len(array) != len(self.pos_w) or len(array) < 2:
                raise InputError("wrong shape", where=name, got=array.shape, expected=f"(N, {shape}), N of 2 or more")
            if not np.isfinite(array).all():
                frame = int(np.argwhere(~np.isfinite(array))[0, 0])
                raise InputError("not finite", where=f"{name}: frame {frame}", expected="finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def num_frames(self) -> int:
        """N."""
        return len(self.pos_w)

    @property
    def duration_s(self) -> float:
        """(N-1)/fps."""
        return (self.num_frames - 1) / self.fps
