"""Parts of recordings by time."""

import numpy as np
import pytest

from core.errors import InputError
from motion.human.motion import HumanMotion
from motion.human.segment import segment_motion


@pytest.fixture
def motion() -> HumanMotion:
    """61 frames at 30 per second; every number is its frame's."""
    number = np.arange(61.0)
    fill = [np.broadcast_to(number.reshape(-1, *[1] * len(s)), (61, *s)) for s in ((22, 3), (22, 4), (2, 4, 3))]
    return HumanMotion(30.0, *fill, source="x.bvh", notes=("a",))


@pytest.mark.parametrize(("start_s", "end_s", "first", "last"), [
    (0.0, None, 0, 60), (0.5, None, 15, 60), (0.0, 2.0, 0, 60), (0.51, 1.0, 16, 30), (1.0, 1.049, 30, 31),
])  # fmt: skip
def test_frames_within_the_times(motion, start_s, end_s, first, last):
    part = segment_motion(motion, start_s, end_s)
    for name in ("pos_w", "quat_wxyz", "sole_w"):
        first_numbers = getattr(part, name).reshape(part.num_frames, -1)[:, 0]
        np.testing.assert_array_equal(first_numbers, np.arange(first, last + 1))
    assert part.fps == 30.0 and part.source == "x.bvh" and part.notes[0] == "a"
    assert (len(part.notes) == 2) == (part.num_frames < 61)


@pytest.mark.parametrize(
    ("start_s", "end_s"), [(-0.1, None), (2.0, None), (1.0, 0.5), (0.0, 2.5), (np.nan, 1.0), (0.0, np.inf)]
)
def test_times_outside(motion, start_s, end_s):
    with pytest.raises(InputError, match=r"^times outside the motion, got .*0 <= start < end <= 2\.000 s"):
        segment_motion(motion, start_s, end_s)


def test_too_short(motion):
    with pytest.raises(InputError, match=r"^too few frames, got 1 frames from 1 to 1\.01 s"):
        segment_motion(motion, 1.0, 1.01)


def test_clips_too(standing_clip):
    clip = standing_clip(root_pos_w=np.arange(31.0)[:, None] * [0.01, 0.0, 0.0] + [0.0, 0.0, 0.8])
    part = segment_motion(clip, 0.5, 0.9)
    np.testing.assert_allclose(part.root_pos_w[:, 0], np.arange(15, 28) / 100.0)
    assert part.joint_names == clip.joint_names and part.contact.shape == (13, 2)
