"""From the loop's commands to LowCmds, and what makes a robot unfit to be commanded."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("cyclonedds")

from core.config import config_file, load_options
from core.errors import InputError
from hal.dds.command import CommandFrames
from hal.dds.layout import CMD, STATE
from hal.dds.link import configuration
from hal.dds.observation import hand_refusal, refusals
from hal.dds.options import DdsOptions, load_dds_options
from hal.dds.slots import SLOT_NAMES, SlotMap
from hal.dds.state_reader import Counts
from hal.wire.outbox import IDLE, Kind, Outgoing
from tests.hal.rigs import G1
from world.actuation import JointCommand, damping_command

FILE = config_file("hal", "dds")
OPTIONS = load_options(DdsOptions, FILE)
SLOTS = SlotMap(G1, OPTIONS.held)
WRISTS = [19, 20, 21, 26, 27, 28]
LIMIT_NM = np.array([25.0, 5.0, 5.0, 25.0, 5.0, 5.0])


def frames() -> CommandFrames:
    return CommandFrames(SLOTS, OPTIONS.held, speed_rad_s=0.5, period_s=0.002)


def motors_at(q: float = 0.0, dq: float = 0.0) -> np.ndarray:
    state = STATE.empty()["motor_state"]
    state["q"], state["dq"] = q, dq
    return state


def track(**changes: np.ndarray) -> Outgoing:
    joints = np.arange(G1.num_joints, dtype=float)
    values = {"q_rad": 0.01 * joints, "dq_rad_s": 0.1 * joints, "kp": 10 + joints, "kd": 1 + joints, "tau_nm": -joints}
    return Outgoing(Kind.TRACK, JointCommand(**(values | changes)))


DAMP = Outgoing(Kind.DAMP, damping_command(G1.damping_kd))


def test_every_joint_is_told_its_own_by_name() -> None:
    sent = CMD.from_body(frames().body(track(), 5, motors_at()))
    assert CMD.intact(sent)
    assert (int(sent["mode_pr"]), int(sent["mode_machine"])) == (0, 5)
    motors = sent["motor_cmd"]
    for i, name in enumerate(G1.joint_names):
        slot = SLOT_NAMES.index(name)
        told = [float(motors[field][slot]) for field in ("q", "dq", "kp", "kd", "tau")]
        np.testing.assert_allclose(told, [0.01 * i, 0.1 * i, 10 + i, 1 + i, -i], rtol=1e-6)
    assert motors["mode"].tolist() == [1] * 29 + [0] * 6
    for field in ("q", "dq", "kp", "kd", "tau", "reserve"):
        assert not motors[field][29:].any()


def test_the_slots_are_the_robots() -> None:
    assert len(SLOT_NAMES) == 29
    for slot, name in ((0, "left_hip_pitch"), (9, "right_knee"), (12, "waist_yaw"), (14, "waist_pitch")):
        assert SLOT_NAMES[slot] == f"{name}_joint"
    for slot, name in ((15, "left_shoulder_pitch"), (19, "left_wrist_roll"), (25, "right_elbow")):
        assert SLOT_NAMES[slot] == f"{name}_joint"
    assert SLOTS.robot.tolist() == [*range(19), 22, 23, 24, 25]
    assert SLOTS.held.tolist() == WRISTS


def test_damping_is_the_robots_damping_and_the_wrists_own() -> None:
    motors = CMD.from_body(frames().body(DAMP, 5, motors_at(0.3)))["motor_cmd"]
    for field in ("q", "dq", "kp", "tau"):
        assert not motors[field].any()
    np.testing.assert_array_equal(motors["kd"][SLOTS.robot], G1.damping_kd)
    assert motors["kd"][WRISTS].tolist() == [1.0] * 6
    assert (motors["mode"][:29] == 1).all()


def test_the_wrists_move_slowly_from_where_they_are() -> None:
    made = frames()
    for i in range(1, 4):
        motors = CMD.from_body(made.body(track(), 5, motors_at(0.2)))["motor_cmd"]
        np.testing.assert_allclose(motors["q"][WRISTS], 0.2 - 0.001 * i, rtol=1e-5)
        assert motors["kp"][WRISTS].tolist() == [20.0] * 6
    for _ in range(300):
        motors = CMD.from_body(made.body(track(), 5, motors_at(0.1)))["motor_cmd"]
    np.testing.assert_allclose(motors["q"][WRISTS], 0.0, atol=1e-9)
    made.body(DAMP, 5, motors_at(-0.4))
    motors = CMD.from_body(made.body(track(), 5, motors_at(-0.4)))["motor_cmd"]
    np.testing.assert_allclose(motors["q"][WRISTS], -0.399, rtol=1e-5)


@pytest.mark.parametrize(("q", "dq"), [(1.5, 0.0), (-1.5, 0.0), (1.5, 4.0), (0.3, -20.0), (0.0, 100.0)])
def test_a_wrist_is_never_asked_for_more_than_its_limit(q: float, dq: float) -> None:
    made = frames()
    made.body(track(), 5, motors_at(0.0))
    motors = CMD.from_body(made.body(track(), 5, motors_at(q, dq)))["motor_cmd"][WRISTS]
    torque_nm = motors["kp"] * (motors["q"] - q) - motors["kd"] * dq
    braking = np.abs(motors["kd"] * dq)
    assert (np.abs(torque_nm) <= np.maximum(LIMIT_NM, braking) * 1.001).all()


def test_a_wrist_of_unknown_state_is_damped() -> None:
    state = motors_at(0.1)
    state["q"][20] = np.nan
    motors = CMD.from_body(frames().body(track(), 5, state))["motor_cmd"]
    assert (float(motors["kp"][20]), float(motors["kd"][20])) == (0.0, 1.0)
    assert np.isfinite(motors["q"]).all()
    assert motors["kp"][19] == 20.0


def test_disabling_takes_everything_away() -> None:
    made = frames()
    made.body(track(), 5, motors_at())
    sent = CMD.from_body(made.disabled_body(5))
    assert CMD.intact(sent)
    assert int(sent["mode_machine"]) == 5
    for field in ("mode", "q", "dq", "kp", "kd", "tau"):
        assert not sent["motor_cmd"][field].any()


def test_what_no_frame_can_hold_is_not_sent() -> None:
    huge = np.zeros(G1.num_joints)
    huge[3] = 1e39
    with pytest.raises(ValueError, match="32-bit"), np.errstate(over="ignore"):
        frames().body(track(q_rad=huge), 5, motors_at())
    with pytest.raises(ValueError, match="IDLE"):
        frames().body(IDLE, 5, motors_at())


def test_robot_and_held_joints_share_out_the_motors() -> None:
    with pytest.raises(InputError, match="motors that nobody holds, got left_wrist_roll_joint"):
        SlotMap(G1, OPTIONS.held[1:])
    twice = (*OPTIONS.held, dataclasses.replace(OPTIONS.held[0], name="left_knee_joint"))
    with pytest.raises(InputError, match="driven and held at once, got left_knee_joint"):
        SlotMap(G1, twice)
    with pytest.raises(InputError, match="unknown motor, got tail"):
        dataclasses.replace(OPTIONS.held[0], name="tail")
    with pytest.raises(InputError, match=r"pos_rad: out of range, got 3\.0"):
        dataclasses.replace(OPTIONS.held[0], pos_rad=3.0)


def observed(**changes: object) -> list[np.ndarray]:
    messages = []
    for i in range(10):
        message = STATE.empty()
        message["tick"], message["mode_machine"] = 1000 + 2 * i, 5
        message["motor_state"]["q"][:29], message["motor_state"]["vol"][:29] = 0.1, 48
        for name, value in changes.items():
            message[name] = value
        messages.append(message)
    return messages


def judge(messages: list[np.ndarray], machine: int = 5, **counts: int) -> str:
    return "; ".join(refusals(messages, Counts(**({"heard": 10} | counts)), OPTIONS.held, machine))


def test_a_healthy_robot_is_not_refused() -> None:
    for machine in (5, 11, 13, 15, 18):
        assert judge(observed(mode_machine=machine), machine) == ""
        other = 5 if machine != 5 else 11
        assert f"mode_machine {machine} is a G1 of another generation" in judge(observed(mode_machine=machine), other)


def test_driven_hands_are_refused() -> None:
    assert hand_refusal({"rt/lowstate", "rt/wirelesscontroller"}) == []
    assert "rt/dex3/left/state" in hand_refusal({"rt/lowstate", "rt/dex3/left/state"})[0]
    assert dataclasses.replace(OPTIONS, mode_machine=13).mode_machine == 13
    for wrong in ({"hands": "dex3"}, {"mode_machine": 4}):
        with pytest.raises(InputError, match=f"{next(iter(wrong))}: "):
            dataclasses.replace(OPTIONS, **wrong)


@pytest.mark.parametrize(
    ("machine", "reason"),
    [(4, "without waist roll and pitch"), (10, "without waist roll and pitch")]
    + [(machine, "waist is locked") for machine in (6, 12, 14, 16)]
    + [(0, "simulation"), (99, "unknown")],
)
def test_machines_that_cannot_be_driven(machine: int, reason: str) -> None:
    said = judge(observed(mode_machine=machine))
    assert f"mode_machine {machine}" in said and reason in said


def test_other_reasons_to_refuse() -> None:
    assert "bad checksum in 3 of 10" in judge(observed(), bad_checksum=3)
    assert "no LowState" in judge([], malformed=10)
    assert "tick stands still" in judge(observed(tick=7))
    assert "mode_pr" in judge(observed(mode_pr=1))
    two = observed()
    two[5]["tick"] = 12
    assert "second robot" in judge(two)
    gone = observed()
    for message in gone:
        message["motor_state"][13] = np.zeros((), dtype=message["motor_state"].dtype)
    gone[-1]["motor_state"]["motorstate"][21] = 0x80000000
    assert "missing motors: waist_roll_joint, left_wrist_yaw_joint" in judge(gone)
    bent = observed()
    bent[-1]["motor_state"]["q"][28] = 2.0
    assert "right_wrist_yaw_joint at 2.00 rad" in judge(bent)
    assert judge(observed(mode_machine=4, mode_pr=1)).count(";") == 1


def test_options_are_checked_and_an_interface_is_needed() -> None:
    with pytest.raises(InputError, match=r"no network interface.*--interface"):
        load_dds_options(FILE, {})
    given = load_dds_options(FILE, {"interface": "eth3", "domain": "7"})
    assert (given.interface, given.domain) == ("eth3", 7)
    for endpoints in ({"interface": "lo", "domain": "x"}, {"interface": "lo", "domain": "233"}):
        with pytest.raises(InputError, match="domain"):
            load_dds_options(FILE, endpoints)
    with pytest.raises(InputError, match="--peer simulator, got interface 'eth3', expected interface lo"):
        load_dds_options(FILE, {"interface": "eth3", "peer": "simulator"})
    simulated = load_dds_options(FILE, {"interface": "lo", "peer": "simulator"})
    assert (simulated.peer, simulated.motion_service) == ("simulator", "none")
    for field, value in (("command_hz", 10.0), ("motion_service", "maybe"), ("release_s", 0.0)):
        with pytest.raises(InputError, match=field):
            dataclasses.replace(OPTIONS, **{field: value})


def test_configuration_of_the_network() -> None:
    lo = configuration("lo")
    assert '<NetworkInterface name="lo"/>' in lo and '<Peer address="127.0.0.1"/>' in lo
    assert "<AllowMulticast>false</AllowMulticast>" in lo
    assert 'name="enp3s0"' in configuration("enp3s0") and "Peer" not in configuration("enp3s0")
    for bad in ("", 'lo"/>', "a b", "x" * 16):
        with pytest.raises(InputError, match="network interface"):
            configuration(bad)
