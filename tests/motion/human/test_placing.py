"""Up and ground of recordings: what decides, and when the question is put back."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.errors import InputError
from core.rotations import quat_rotate
from motion.human.placing import UPRIGHT_WXYZ, find_ground, find_up
from tests.motion.human.people import standing

FEET = np.array([[-0.05, 0.0, 0.0], [0.12, -0.02, 0.0], [0.1, 0.06, 0.0], [0.19, 0.02, 0.0]])
AXES = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1], "-x": [-1, 0, 0], "-y": [0, -1, 0], "-z": [0, 0, -1]}


def body(along: str, ground: float = 0.0, lean_rad: float = 0.0) -> np.ndarray:
    """Joints (4,22,3) of somebody who stands along an axis, leaning aside, `ground` above zero along it."""
    up = Rotation.align_vectors([AXES[along]], [[0, 0, 1]])[0]
    places = np.add(standing().places(), [0.0, 0.0, ground])
    return up.apply(Rotation.from_euler("x", lean_rad).apply(places.reshape(-1, 3))).reshape(places.shape)


def test_upright_rotations():
    for name, axis in AXES.items():
        np.testing.assert_allclose(quat_rotate(UPRIGHT_WXYZ[name], np.array(axis, float)), [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("axis", AXES)
def test_bodies_stand_along_the_up_axis(axis):
    assert find_up(body(axis), axis, "files", None, "a")[0] == axis
    assert find_up(body(axis, ground=5.0), axis, "files", None, "a")[0] == axis
    assert find_up(body(axis, lean_rad=0.6), axis, "files", None, "a")[0] == axis


@pytest.mark.parametrize("axis", ["x", "y", "-y"])
def test_ground_decides_against_what_is_usual(axis):
    """Far from zero along the usual axis, on the ground along the other."""
    aside = body(axis) + np.array([0.0, 0.0, 2.0])
    found, note = find_up(aside, "z", "AMASS files", None, "a")
    assert found == axis and note.startswith(
        f"Up is the axis {axis}, not z as in AMASS files: the body stands along it"
    )


def test_in_doubt_it_is_asked():
    with pytest.raises(InputError, match=r"^a: unclear which way is up, got a body along the axis y \(1\.00 of"):
        find_up(body("y", ground=1.0), "z", "AMASS files", None, "a")
    with pytest.raises(InputError, match=r"while AMASS files have z up; say it: --up=z or --up=y"):
        find_up(body("y") * [1.0, 1.0, 0.1], "z", "AMASS files", None, "a")


def test_given():
    found, note = find_up(body("z"), "z", "files", "-x", "a")
    assert found == "-x" and note == "Up is the axis -x, as given."


def soles(heights: np.ndarray, slope_rad: float = 0.0) -> np.ndarray:
    """Sole points (N,2,4,3), both feet at `heights` (N,2), toes down by `slope_rad`."""
    points = Rotation.from_euler("y", slope_rad).apply(FEET)
    return np.broadcast_to(points, (*heights.shape, 4, 3)) + heights[..., None, None] * [0.0, 0.0, 1.0]


def test_ground_is_where_feet_stand():
    """One foot stands at 0.3 for a second, the other is swung below it, as a stiff foot's tip when kneeling."""
    heights = np.tile([0.3, 0.26], (60, 1))
    points = soles(heights)
    points[:, 1] = soles(heights, slope_rad=1.2)[:, 1]
    ground, note = find_ground(points, 30.0, "a")
    assert ground == pytest.approx(0.3) and note.startswith("The whole motion was lowered by 0.300 m")
    assert "standing soles" in note


def test_ground_without_standing_feet():
    """Nobody stands: the lowest soles count, but not a single bad frame."""
    heights = np.tile(np.abs(np.sin(np.arange(100) * 0.7))[:, None], (1, 2)) - 0.5
    heights[40] = -3.0
    ground, note = find_ground(soles(heights, slope_rad=0.5), 30.0, "a")
    lowest = -0.19 * np.sin(0.5)
    assert ground == pytest.approx(-0.5 + lowest, abs=0.08) and "raised" in note and "lowest soles" in note


def test_stairs_do_not_lift_the_ground():
    heights = np.zeros((90, 2))
    heights[30:] = 0.5
    assert find_ground(soles(heights), 30.0, "a")[0] == pytest.approx(0.0, abs=1e-9)


def test_far_from_the_ground():
    with pytest.raises(InputError, match=r"^a: far from the ground, got -90 m, .*is the unit of the positions right\?"):
        find_ground(soles(np.full((10, 2), -90.0)), 30.0, "a")
