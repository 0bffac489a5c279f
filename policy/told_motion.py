"""Whether the clip given to an actor is the motion that its own graph hands out, where it does that.

Trackers of other stacks hand out the joints of their motion by the number of the frame, one frame a control period.
"""

from __future__ import annotations

import numpy as np

from core.errors import InputError
from policy.actor import Actor
from policy.graph import FRAME

JOINTS = "joint_pos"
NEAR_RAD = 0.1  # a clip may have been filtered since; another clip, or another rate, is further off


def check_told_motion(actor: Actor, joint_pos_rad: np.ndarray) -> None:
    """InputError unless the clip (T, J), row by row of the control period in the actor's order, is that motion."""
    outputs = {entry.name for entry in actor.session.get_outputs()}
    if FRAME not in actor.constant or JOINTS not in outputs:
        return
    last = len(joint_pos_rad) - 1
    for frame, row in ((0, 0), (last // 2, last // 2), (last, last), (last + 50, last)):
        told = _told(actor, frame)
        off = np.abs(told - joint_pos_rad[row])
        if off.max() > NEAR_RAD:
            joint = actor.spec.joint_names[int(off.argmax())]
            raise InputError(
                "the motion given is not the one this actor was trained on, or is played at another rate",
                where=actor.path,
                got=f"{joint} at {joint_pos_rad[row][off.argmax()]:.2f} rad in frame {frame}",
                expected=f"{told[off.argmax()]:.2f} rad, which the actor's own graph says",
            )


def _told(actor: Actor, frame: int) -> np.ndarray:
    feed = {entry.name: np.zeros((1, entry.shape[1]), np.float32) for entry in actor.session.get_inputs()}
    feed[FRAME] = np.array([[frame]], np.float32)
    (joints,) = actor.session.run([JOINTS], feed)
    return np.asarray(joints, np.float64).reshape(-1)
