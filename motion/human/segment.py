"""A part of a recording."""

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from core.errors import InputError
from motion.clip import Clip
from motion.human.motion import HumanMotion

_ARRAYS = {
    HumanMotion: ("pos_w", "quat_wxyz", "sole_w"),
    Clip: ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact"),
}
_Recording = TypeVar("_Recording", bound=HumanMotion | Clip)


def segment_motion(motion: _Recording, start_s: float = 0.0, end_s: float | None = None) -> _Recording:
    """The frames of `motion` (a Clip likewise) from `start_s` to `end_s`, its end by default, both included.

    Raises InputError when the times are not within it or fewer than two frames are left.
    """
    last = motion.duration_s if end_s is None else end_s
    if not (0.0 <= start_s < last <= motion.duration_s + 0.5 / motion.fps):
        expected = f"0 <= start < end <= {motion.duration_s:.3f} s, the length of the motion"
        raise InputError("times outside the motion", got=f"{start_s:g} to {last:g} s", expected=expected)
    first = int(np.ceil(start_s * motion.fps - 1e-6))
    stop = min(int(np.floor(last * motion.fps + 1e-6)) + 1, motion.num_frames)
    if stop - first < 2:
        got = f"{max(stop - first, 0)} frames from {start_s:g} to {last:g} s"
        raise InputError("too few frames", got=got, expected="2 or more")
    part: dict[str, Any] = {name: getattr(motion, name)[first:stop] for name in _ARRAYS[type(motion)]}
    if isinstance(motion, HumanMotion) and stop - first < motion.num_frames:
        part["notes"] = (*motion.notes, f"Cut to {start_s:g} to {last:g} s of the recording.")
    return replace(motion, **part)
