"""What is refused before anything is energised, and with which words."""

from dataclasses import replace

import numpy as np
import pytest

from core.clock import SimulatedClock
from deploy.actors import load_run
from deploy.preflight import Check, PreflightRefused, require, run_preflight, table
from hal.contract.types import LinkLost, NoState
from policy.inputs import HeldJoint
from tests.deploy.toys import (
    JOINTS,
    KNEE,
    ROBOT,
    SETTINGS,
    FakeBackend,
    linear_run,
    state,
    tilted,
    with_joint,
    write_linear_actor,
)
from world.scene import Box, Scene


def checks_for(tmp_path, script, *, at_rest=True, joint_names=ROBOT.joint_names, actors=None, **device):
    clock = SimulatedClock()
    backend = FakeBackend(script, clock)
    info = replace(backend.open(), joint_names=tuple(joint_names), **device)
    actors = actors or [linear_run(tmp_path)]
    checks = run_preflight(backend, info, clock, ROBOT, actors, SETTINGS.preflight, at_rest=at_rest)
    assert "write" not in backend.calls
    return checks


def test_a_healthy_robot_passes_and_the_table_says_what_was_checked(tmp_path):
    checks = checks_for(tmp_path, [state()])
    require(checks)
    text = table(checks)
    for what in ("joint names", "actor toy", "state age", "temperatures", "gravity", "joint ranges", "watchdog"):
        assert what in text
    assert "none: only this computer can damp" in text


def test_what_the_battery_reports_is_in_the_table(tmp_path):
    rows = [line.split() for line in table(checks_for(tmp_path, [state()])).splitlines()]
    assert ["ok", "battery", "not", "reported"] in rows
    checks = checks_for(tmp_path, [state(charge=0.3, supply=0.95, supply_high=1.05)])
    require(checks)
    assert "charge 30 %, supply 95 %, highest 105 %" in table(checks)


def test_the_boxes_of_a_motion_are_in_the_table(tmp_path):
    assert "scene" not in table(checks_for(tmp_path, [state()]))
    path = write_linear_actor(tmp_path / "up.onnx", name="up", scene=Scene(boxes=(Box((1, 0, 0), (1, 1, 0.2)),) * 2))
    checks = checks_for(tmp_path, [state()], actors=[linear_run(tmp_path), load_run(path, None, ROBOT, SETTINGS.entry)])
    assert Check("scene", True, "2 boxes, put up where the motion has them?") in checks


UNFIT = [
    (with_joint("joint_pos_rad", ROBOT.pos_upper_rad[KNEE] + 0.06), "joint ranges: left_knee_joint"),
    (with_joint("temperature_c", 71.0), "temperatures: hottest left_knee_joint at 71 C"),
    (state(charge=0.29), "battery: the battery is at 29 %, limit 30 %: charge it"),
    (state(charge=0.8, supply=0.89), "battery: the supply is at 89 % of its voltage, limit 90 %: charge it"),
    (state(supply=1.0, supply_high=1.16), "battery: the supply is at 116 % of its voltage, limit 115 %: check what"),
    (state(faults=("motor 3",)), "device faults: motor 3"),
    (state(imu_quat_wxyz=tilted(0.09)), "gravity and quaternion: 5.2 degrees"),
    (state(imu_quat_wxyz=tilted(0.36)), "upright: leans by 0.36 rad, limit 0.35"),
    (state(imu_quat_wxyz=tilted(np.pi)), "upright: leans by 3.14 rad"),
    (state(imu_acc_b=np.array([0.0, 0.0, 8.7])), "acceleration at rest: 8.70"),
    (with_joint("joint_age_s", 0.05), "state age: at most 50.0 ms"),
    (with_joint("joint_pos_rad", np.nan), "numbers: not finite"),
    (with_joint("joint_torque_nm", np.nan), "numbers: not finite"),
    (state(imu_quat_wxyz=np.zeros(4)), "numbers: finite, the quaternion is no rotation"),
]


@pytest.mark.parametrize(("unfit", "says"), UNFIT)
def test_refuses_with_the_reason(tmp_path, unfit, says):
    with pytest.raises(PreflightRefused, match="preflight refused") as refusal:
        require(checks_for(tmp_path, [unfit]))
    assert says in str(refusal.value)


def test_gravity_agrees_with_the_quaternion_when_leaning(tmp_path):
    """A lean forward of 0.2 rad: up in the base frame is (-sin, 0, cos)."""
    leaning = state(imu_quat_wxyz=tilted(0.2), imu_acc_b=9.81 * np.array([-np.sin(0.2), 0.0, np.cos(0.2)]))
    require(checks_for(tmp_path, [leaning]))


def test_what_is_not_at_rest_is_not_judged_by_gravity(tmp_path):
    require(checks_for(tmp_path, [state(imu_acc_b=np.zeros(3))], at_rest=False))


def test_gains_that_a_motor_would_cut_are_refused_by_name(tmp_path):
    """The toy has the robot's own: kp 150 and kd 4 of a knee."""
    enough, cuts = {"left_knee_joint": (150.0, 4.0)}, {"left_knee_joint": (500.0, 3.5), "left_elbow_joint": (10.0, 9.0)}
    require(checks_for(tmp_path, [state()], gain_limits=enough))
    with pytest.raises(PreflightRefused, match=r"knee_joint is 4, its motor takes at most 3\.5; kp of left_el"):
        require(checks_for(tmp_path, [state()], gain_limits=cuts))


def test_held_joints_are_the_robots_too_and_so_are_their_gains(tmp_path):
    """An actor that moves 22 joints and holds the left elbow with kp 10."""
    run, elbow = linear_run(tmp_path), ROBOT.joint_names.index("left_elbow_joint")
    spec, moved = run.actor.spec, [i for i in range(JOINTS) if i != elbow]
    fewer = {name: getattr(spec, name)[moved] for name in ("default_pos_rad", "kp", "kd", "action_scale")}
    names = tuple(spec.joint_names[i] for i in moved)
    held = (HeldJoint("left_elbow_joint", 0.3, 10.0, 1.0),)
    run.actor = replace(run.actor, spec=replace(spec, joint_names=names, held_joints=held, motion=None, **fewer))
    require(checks_for(tmp_path, [state()], actors=[run]))
    with pytest.raises(PreflightRefused, match=r"kp of left_elbow_joint is 10, its motor takes at most 9"):
        require(checks_for(tmp_path, [state()], actors=[run], gain_limits={"left_elbow_joint": (9.0, 9.0)}))


def test_other_joint_names_are_refused(tmp_path):
    with pytest.raises(PreflightRefused, match="joint names: differ: left_knee_joint, wing_joint"):
        require(
            checks_for(
                tmp_path,
                [state()],
                joint_names=["wing_joint" if n == "left_knee_joint" else n for n in ROBOT.joint_names],
            )
        )


def test_waits_for_the_first_state_but_not_for_ever(tmp_path):
    require(checks_for(tmp_path, [NoState("not yet")] * 20 + [state()]))
    with pytest.raises(NoState, match="not yet"):
        checks_for(tmp_path, [NoState("not yet")])
    with pytest.raises(LinkLost):
        checks_for(tmp_path, [LinkLost("gone")])


LOST = [LinkLost("silent for 120 ms")]


def test_a_short_gap_in_the_link_begins_the_settling_anew_and_is_said(tmp_path):
    """What was read before the gap, here a joint out of range, does not count."""
    before = with_joint("joint_pos_rad", ROBOT.pos_upper_rad[KNEE] + 0.06)
    checks = checks_for(tmp_path, [before] * 30 + LOST * 5 + [state()])
    require(checks)
    assert "lost 1x, for 120 ms at most, then steady" in table(checks)
    assert "link             ok  steady" not in table(checks)


@pytest.mark.parametrize("script", [[state()] + LOST * 40 + [state()], ([state()] * 20 + LOST * 3) * 20])
def test_a_long_gap_or_one_after_another_is_a_lost_link(tmp_path, script):
    with pytest.raises(LinkLost, match="silent for 120 ms"):
        checks_for(tmp_path, script)
