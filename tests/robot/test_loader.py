"""Loading robots: what the two robots are, and every way in which a description can be wrong."""

import copy
import re

import numpy as np
import pytest
import yaml

from core.errors import InputError
from robot.robot import load_robot
from tests.robot.toy import TOY_YAML, load_toy


@pytest.fixture
def broken(tmp_path):
    """A function that loads the toy after ``change`` was made to its table."""

    def load(change):
        table = yaml.safe_load(TOY_YAML.read_text())
        table["mjcf"] = str(TOY_YAML.parent / "toy.xml")
        change(table)
        path = tmp_path / "broken.yaml"
        path.write_text(yaml.safe_dump(table))
        return load_robot(path)

    return load


def test_g1_is_what_the_paper_used():
    robot = load_robot()
    assert robot.num_joints == 23
    assert len(robot.body_names) == 24 and len(robot.tracked_names) == 27
    assert robot.body_names[0] == robot.root_body == "pelvis"
    assert robot.tracked_names[-3:] == ("left_hand_link", "right_hand_link", "head_link")
    assert len(robot.lower_tracked) == 16 and len(robot.upper_tracked) == 11
    assert set(robot.lower_tracked) | set(robot.upper_tracked) == set(robot.tracked_names)
    assert len(robot.randomized_mass_bodies) == 22
    knee = robot.joint_names.index("left_knee_joint")
    row = (robot.default_pos_rad, robot.kp, robot.kd, robot.vel_limit_rad_s, robot.torque_limit_nm)
    assert [values[knee] for values in row] == [0.3, 150, 4, 20, 139]


def test_g1_penalised_contacts_are_the_named_parts():
    robot = load_robot()
    parts = ("pelvis", "shoulder", "hip", "torso", "waist", "elbow")
    expected = {body for body in robot.body_names if any(part in body for part in parts)}
    assert set(robot.penalized_contact_bodies) == expected


def test_toy_is_another_robot():
    toy = load_toy()
    assert toy.joint_names == ("left_hip", "left_ankle", "right_hip", "right_ankle")
    assert toy.tracked_names == ("trunk", "left_leg", "left_foot", "right_leg", "right_foot", "head")
    assert np.array_equal(toy.damping_kd, [3, 1, 3, 1])
    assert np.allclose(toy.sole_points_m["left_foot"][:, 2], -0.03)


def test_arrays_cannot_be_written():
    robot = load_robot()
    with pytest.raises(ValueError, match="read-only"):
        robot.kp[0] = 1.0


def test_soft_limits_keep_the_middle():
    lower, upper = load_toy().soft_pos_limits_rad()
    assert np.isclose(lower[0], -1.365) and np.isclose(upper[0], 1.065)  # -0.15 -+ 0.9 * 1.35


def test_joint_index_reorders_by_name():
    toy = load_toy()
    names = ["right_ankle", "left_hip", "right_hip", "left_ankle"]
    values = np.array([3.0, 0.0, 2.0, 1.0])
    assert np.array_equal(values[toy.joint_index(names)], [0, 1, 2, 3])


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["left_hip", "left_ankle", "right_hip", "tail"], "unknown tail, missing right_ankle"),
        (["left_hip", "left_ankle", "right_hip"], "missing right_ankle"),
        (["left_hip", "left_ankle", "right_hip", "right_ankle", "left_hip"], "duplicate left_hip"),
    ],
)
def test_joint_index_names_the_wrong_joints(names, message):
    with pytest.raises(InputError, match=message):
        load_toy().joint_index(names)


def test_tracked_index_names_what_it_does_not_know():
    toy = load_toy()
    assert list(toy.tracked_index(["head", "trunk"])) == [5, 0]
    with pytest.raises(InputError, match="got tail"):
        toy.tracked_index(["tail"])


def _set(table, *path_and_value):
    *path, last, value = path_and_value
    for key in path:
        table = table[key]
    table[last] = value


def _row(table, name):
    return next(row for row in table["joints"] if row["name"] == name)


BROKEN = {
    "unknown joint": (lambda t: _row(t, "left_hip").update(name="tail"), "joints: unknown tail, missing left_hip"),
    "missing joint": (lambda t: t["joints"].pop(1), "joints: missing left_ankle"),
    "duplicate joint": (lambda t: t["joints"].append(copy.copy(t["joints"][0])), "joints: given twice, got left_hip"),
    "wrong order": (
        lambda t: t["joints"].reverse(),
        "joints[0]: not in the MJCF's order, got right_ankle, expected left_hip",
    ),
    "range of one": (
        lambda t: _row(t, "left_hip").update(range_rad=[1.0]),
        "joints[0 left_hip].range_rad: wrong length, got [1.0]",
    ),
    "empty range": (
        lambda t: _row(t, "left_hip").update(range_rad=[1.0, -1.0]),
        "joints[0 left_hip].range_rad: empty range",
    ),
    "nan": (lambda t: _row(t, "left_hip").update(kp=float("nan")), "joints[0 left_hip].kp: not finite, got nan"),
    "text": (
        lambda t: _row(t, "left_hip").update(kd="stiff"),
        "joints[0 left_hip].kd: wrong type, got 'stiff', expected a number",
    ),
    "negative gain": (
        lambda t: _row(t, "left_hip").update(kp=-1),
        "joints[0 left_hip].kp: not positive, got -1.0, expected a",
    ),
    "other range": (
        lambda t: _row(t, "left_hip").update(range_rad=[-1.4, 1.2]),
        "joints[0 left_hip].range_rad: not the MJCF's, got [-1.4, 1.2], expected [-1.5, 1.2]",
    ),
    "other torque": (
        lambda t: _row(t, "left_hip").update(torque_nm=61),
        "joints[0 left_hip].torque_nm: not the MJCF's, got 61.0, expected 60.0",
    ),
    "pose outside": (
        lambda t: _row(t, "left_hip").update(default_rad=2),
        "joints[0 left_hip].default_rad: out of range, got 2.0, expected a number in [-1.5, 1.2] rad",
    ),
    "missing column": (lambda t: _row(t, "left_hip").pop("kd"), "joints[0 left_hip].kd: missing key"),
    "unknown column": (
        lambda t: _row(t, "left_hip").update(stiffness=3),
        "joints[0 left_hip].stiffness: unknown key, expected one of name, default_rad, kp",
    ),
    "unknown field": (lambda t: t.update(colour="red"), "colour: unknown key, expected one of name, mjcf"),
    "missing field": (lambda t: t.pop("feet"), "feet: missing key"),
    "no joints": (lambda t: t.update(joints=[]), "joints: no joints"),
    "unknown body": (
        lambda t: t.update(penalized_contact_bodies=["tail"]),
        "penalized_contact_bodies[0]: unknown body or point, got tail, expected one of trunk",
    ),
    "repeated body": (
        lambda t: t.update(ankle_bodies=["left_foot", "left_foot"]),
        "ankle_bodies: given twice, got left_foot",
    ),
    "point on nothing": (
        lambda t: _set(t, "points", 0, "parent", "tail"),
        "points[0 head].parent: unknown body, got tail",
    ),
    "flat point": (
        lambda t: _set(t, "points", 0, "offset_m", [0, 0]),
        "points[0 head].offset_m: wrong length, got [0, 0], expected a list of 3 numbers",
    ),
    "point like a body": (lambda t: _set(t, "points", 0, "name", "trunk"), "points: given twice, got trunk"),
    "foot without sole": (lambda t: _set(t, "feet", "left", "trunk"), "3 or more colliding spheres, got 0 on trunk"),
    "other root": (lambda t: t.update(root_body="left_leg"), "the root must be the MJCF's first body"),
    "no imu": (lambda t: t.update(imu_site="nose"), "imu_site: not in the MJCF, got nose, expected one of imu"),
    "soft factor": (lambda t: t.update(soft_limit_factor=1.2), "soft_limit_factor: out of range, got 1.2"),
    "no mjcf": (lambda t: t.update(mjcf="nowhere.xml"), "mjcf: no such file"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_descriptions_are_refused_by_name(broken, case):
    change, message = BROKEN[case]
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        broken(change)
    assert "\n" not in str(caught.value) and "broken.yaml" in str(caught.value)


def test_unknown_robot_lists_the_bundled_ones():
    with pytest.raises(InputError, match=r"unknown robot configuration, got g2, expected one of g1_23dof"):
        load_robot("g2")


def test_a_key_given_twice_is_refused(tmp_path):
    path = tmp_path / "twice.yaml"
    path.write_text("name: a\nname: b\n")
    with pytest.raises(InputError, match="not a readable YAML file"):
        load_robot(path)


def test_an_mjcf_that_mujoco_refuses_is_named(tmp_path, broken):
    (tmp_path / "bad.xml").write_text("<mujoco><worldbody><body/></mujoco>")
    with pytest.raises(InputError, match="MuJoCo cannot read the model"):
        broken(lambda table: table.update(mjcf=str(tmp_path / "bad.xml")))
