"""One bus of servos, round by round: who is told what, who said what, and how old it is."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from hal.can.codec import MotorCommand
from hal.can.frame import Frame
from hal.can.setup import bring_back, commanded_by_others, prepare, switch_off, switch_on
from hal.contract.types import DeviceError, DeviceFault
from tests.hal.can.rig import ELBOW, G1, HIP, KNEE, Rig, index, motor, robot_file

pytestmark = pytest.mark.real_time

MIXED = (
    motor(HIP, 1),
    motor(
        KNEE,
        2,
        codec="robstride",
        model="RS04",
        direction=-1,
        zero_rad=2.0,
        gear=1.3,
        limits=replace(motor(HIP, 1).limits),
    ),
    motor(ELBOW, 9, codec="cubemars", model="AK70-10", zero_rad=-1.0, options={"keeps_zero": True}),
)


def ready(rig: Rig, on: bool = True) -> Rig:
    for one in rig.bus.motors:
        prepare(rig.bus, one, rig.file.watchdog_s)
    if on:
        for one in rig.bus.motors:
            switch_on(rig.bus, one)
    rig.begin()
    rig.damp()
    return rig


def joint(rig: Rig, name: str) -> float:
    snapshot = rig.board.snapshot()
    assert snapshot is not None
    return float(snapshot.joint_pos_rad[index(name)])


@pytest.mark.parametrize("motors", [(), MIXED], ids=["one protocol", "three protocols"])
def test_every_joint_is_read_and_told_in_its_own_terms(motors: tuple) -> None:
    rig = ready(Rig(robot_file(*motors)))
    target = G1.default_pos_rad + 0.1
    rig.track(target, kp=30.0, kd=1.5, tau_nm=2.0)
    rig.round(3)
    for name in (HIP, KNEE, ELBOW):
        assert joint(rig, name) == pytest.approx(rig.robot.pos_rad[index(name)], abs=0.02)
        q, dq, kp, kd, tau = rig.told(name)
        assert (q, kp, kd) == pytest.approx((target[index(name)], 30.0, 1.5), abs=0.13)
        assert tau == pytest.approx(2.0, abs=0.15)
        assert dq == 0.0


@pytest.mark.parametrize(("nominal_v", "share"), [(28.0, 0.875), (None, math.nan)])
def test_the_supply_that_an_odrive_reports_is_judged_against_the_nominal_one(
    nominal_v: float | None, share: float
) -> None:
    rig = Rig(robot_file(motor(HIP, 3, codec="odrive", model="S1"), motor(KNEE, 2), supply_v=nominal_v))
    rig.begin()
    rig.link.say(Frame(0x77, bytes.fromhex("0000C441000080BF")))  # 24.5 V
    rig.round(2)
    snapshot = rig.board.snapshot()
    assert snapshot is not None and snapshot.supply == pytest.approx(share, nan_ok=True)


def test_damping_is_kp_zero_with_the_robots_kd() -> None:
    rig = ready(Rig(robot_file(*MIXED)))
    rig.track(G1.default_pos_rad)
    rig.round()
    rig.damp()
    rig.round()
    for name in (HIP, KNEE, ELBOW):
        _, dq, kp, kd, tau = rig.told(name)
        assert (kp, dq, tau) == (0.0, 0.0, 0.0)
        assert kd == pytest.approx(G1.damping_kd[index(name)], abs=0.01)


def test_nothing_drives_a_motor_before_it_is_enabled() -> None:
    rig = ready(Rig(robot_file(*MIXED)), on=False)
    rig.track(G1.default_pos_rad + 0.3)
    rig.round(5)
    assert not any(one.enabled for one in rig.motors)
    assert not rig.robot.told[:5].any()
    snapshot = rig.board.snapshot()
    assert snapshot is not None and math.isfinite(snapshot.joint_stamp_s[index(HIP)])


def test_a_lost_turn_is_found_at_start() -> None:
    """Zeros beyond half a turn: the motor wakes up within half a turn of its own zero, whole turns away."""
    rig = ready(Rig(robot_file(motor(HIP, 1, zero_rad=3.3), motor(KNEE, 2, zero_rad=-3.6))))
    rig.round()
    assert np.any(rig.bus.map.turns != 0)
    for name in (HIP, KNEE):
        assert joint(rig, name) == pytest.approx(rig.robot.pos_rad[index(name)], abs=1e-3)


def test_a_joint_outside_its_band_is_refused_by_name() -> None:
    rig = Rig(robot_file(motor(KNEE, 2)))
    rig.robot.lower_rad[:] = -3.0
    rig.robot.pos_rad[index(KNEE)] = -1.5
    with pytest.raises(DeviceFault, match=r"left_knee_joint: at -1\.500 rad, outside"):
        prepare(rig.bus, rig.bus.motors[0], 0.2)
    assert not rig.motors[0].enabled


def test_the_watchdog_is_set_and_read_back() -> None:
    rig = ready(Rig(robot_file(*MIXED[:2])))
    assert [one.values["watchdog_s"] for one in rig.motors] == pytest.approx([0.2, 0.2])
    stubborn = Rig(robot_file(motor(HIP, 1)))
    stubborn.motors[0].values = Stubborn()
    with pytest.raises(DeviceFault, match=r"its watchdog reads 0 s after setting 0\.2 s"):
        prepare(stubborn.bus, stubborn.bus.motors[0], 0.2)


class Stubborn(dict):
    """A motor that answers writes and forgets them."""

    def __init__(self) -> None:
        super().__init__(watchdog_s=0.0)

    def __setitem__(self, key: str, value: float) -> None:
        return


def test_when_nobody_speaks_the_motor_lets_go() -> None:
    rig = ready(Rig(robot_file(motor(HIP, 1), motor(KNEE, 2, codec="robstride", model="RS04", gear=1.3))))
    rig.track(G1.default_pos_rad)
    rig.round()
    time.sleep(0.25)
    for one in rig.motors:
        one.keep(time.monotonic())
    assert [one.enabled for one in rig.motors] == [False, False]
    rig.round()
    assert rig.shown == (
        f"motor_fault:{HIP}: communication_lost",
        f"motor_fault:{KNEE}: it has switched itself off",
    )


def test_the_scaling_is_the_motors_own() -> None:
    """Its registers say 8 rad/s where the table says 25: with the table, speeds would be three times too high."""
    rig = Rig(robot_file(motor(HIP, 1)))
    rig.motors[0].codec = replace(rig.motors[0].codec, model=replace(rig.motors[0].codec.model, vel_rad_s=8.0))
    ready(rig)
    rig.robot.vel_rad_s[index(HIP)] = 1.0
    rig.round()
    snapshot = rig.board.snapshot()
    assert snapshot is not None
    assert snapshot.joint_vel_rad_s[index(HIP)] == pytest.approx(rig.robot.vel_rad_s[index(HIP)], abs=0.1)


def test_a_silent_motor_ages_its_own_joint_only() -> None:
    rig = ready(Rig())
    rig.round()
    rig.faults.add("silence", KNEE)
    silent_s = time.monotonic()
    time.sleep(0.05)
    rig.round(3)
    snapshot = rig.board.snapshot()
    assert snapshot is not None
    assert snapshot.joint_stamp_s[index(KNEE)] < silent_s
    assert snapshot.joint_stamp_s[[index(HIP), index(ELBOW)]].min() > silent_s
    assert rig.board.all_stats()["bus answers missed"] > 0


def test_an_acknowledgement_is_no_state() -> None:
    """A write's echo, a question of another program and garbage leave the state alone."""
    rig = ready(Rig(robot_file(motor(HIP, 1))))
    rig.round()
    before = joint(rig, HIP)
    rig.faults.add("silence", HIP)
    for data in ("0100550900000000", "0100CC0000000000", "0100330900000000", "0080"):
        rig.link.say(Frame(0x11, bytes.fromhex(data)))
    rig.link.say(Frame(0x012, bytes(8)))
    rig.round()
    assert joint(rig, HIP) == before
    assert rig.bus._demultiplexer.not_understood >= 3


def test_a_motors_fault_is_shown_and_latched_until_the_operators_word() -> None:
    rig = ready(Rig())
    rig.faults.add("fault_code", KNEE, duration_s=0.05)
    rig.round(2)
    assert rig.shown == (f"motor_fault:{KNEE}: over_current",)
    time.sleep(0.06)
    rig.track(G1.default_pos_rad)
    rig.round(2)
    assert rig.shown == (f"motor_fault:{KNEE}: over_current",)
    assert not rig.motors[1].enabled
    assert rig.told(HIP)[2] > 0
    rig.damp()
    bring_back(rig.bus, rig.bus.motors[1], 0.2, on=True)
    rig.round()
    assert rig.shown == ()
    assert rig.motors[1].enabled
    assert rig.told(KNEE)[2] == 0.0


def test_a_power_cycled_motor_stays_off_until_the_operators_word() -> None:
    rig = ready(Rig())
    rig.track(G1.default_pos_rad)
    rig.round()
    rig.faults.add("brown_out", ELBOW, duration_s=0.05)
    rig.round(2)
    time.sleep(0.06)
    rig.round(5)
    assert not rig.motors[2].enabled
    assert rig.shown == (f"motor_fault:{ELBOW}: it has switched itself off",)


def test_a_lost_zero_is_noticed_while_running() -> None:
    rig = ready(Rig())
    rig.track(G1.default_pos_rad)
    rig.round()
    rig.faults.add("power_cycled_zero", HIP)
    rig.round(3)
    assert any("lost its zero" in name for name in rig.shown)
    assert rig.told(HIP)[2] == 0.0
    assert rig.told(KNEE)[2] > 0.0


def test_an_adapter_that_goes_is_damped_and_comes_back_on_the_operators_word() -> None:
    rig = ready(Rig())
    rig.track(G1.default_pos_rad)
    rig.round()
    rig.link.gone = True
    with pytest.raises(DeviceError, match="bus bus: cannot send"):
        rig.round()
    assert rig.shown == ("bus bus: cannot send: gone",)
    with pytest.raises(DeviceError):
        rig.round()
    with pytest.raises(DeviceError):
        rig.bus.mend()
    rig.link.gone = False
    rig.round()
    assert rig.told(HIP)[2] == 0.0, "back on the wire, only damping is sent"
    rig.bus.mend()
    rig.round()
    assert rig.shown == ()
    assert rig.told(HIP)[2] > 0.0


def test_what_cannot_be_sent_damps_that_motor_and_is_said() -> None:
    """Damiao: stiffness without damping is refused by the codec."""
    rig = ready(Rig())
    rig.track(G1.default_pos_rad, kp=20.0, kd=0.0)
    with pytest.raises(DeviceError, match="expected kd above 0"):
        rig.round()
    for name in (HIP, KNEE, ELBOW):
        assert rig.told(name)[2] == 0.0


def test_the_feed_forward_stays_within_the_limit() -> None:
    file = robot_file(motor(HIP, 1, limits=replace(motor(HIP, 1).limits, torque_nm=10.0)))
    rig = ready(Rig(file))
    rig.track(G1.default_pos_rad, tau_nm=500.0)
    rig.round()
    assert rig.told(HIP)[4] == pytest.approx(10.0, abs=0.1)


def test_another_controller_is_noticed() -> None:
    rig = Rig()
    assert commanded_by_others(rig.bus) == []
    for frame in rig.bus.motors[1].codec.command(MotorCommand(kp=1.0, kd=1.0)):
        rig.link.say(frame)
    assert commanded_by_others(rig.bus) == [KNEE]


def test_switching_off_is_repeated_until_it_is_confirmed() -> None:
    rig = ready(Rig())
    rig.bus.end_rounds()
    heard = []
    hear = rig.motors[0].hear
    rig.motors[0].hear = lambda frame, now_s: () if len(heard) < 3 and not heard.append(frame) else hear(frame, now_s)
    switch_off(rig.bus, rig.bus.motors[:1])
    assert not rig.motors[0].enabled


def test_switching_off_takes_half_a_second_however_many_are_silent() -> None:
    """And what hears is switched off, though it comes last."""
    rig = ready(Rig())
    rig.bus.end_rounds()
    rig.faults.add("deaf", HIP)
    rig.faults.add("silence", KNEE)
    begun_s = time.monotonic()
    silent = (
        r"not confirmed within 0\.5 s that it is off: left_hip_pitch_joint \(damiao 1\), left_knee_joint \(damiao 2\)$"
    )
    with pytest.raises(DeviceError, match=silent):
        switch_off(rig.bus, rig.bus.motors)
    assert 0.5 <= time.monotonic() - begun_s < 0.8
    assert [one.enabled for one in rig.motors] == [True, False, False]


def test_a_round_looks_for_answers_when_the_wire_can_have_carried_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three Damiao: six frames of 8 bytes, 135 bits each with the most stuff bits, at 1 Mbit/s."""
    rig = ready(Rig())
    sent_s, looked_s = [], []
    send, receive = rig.link.send, rig.link.receive
    monkeypatch.setattr(rig.link, "send", lambda frames: (sent_s.append(time.monotonic()), send(frames)))
    monkeypatch.setattr(rig.link, "receive", lambda until_s: (looked_s.append(time.monotonic()), receive(until_s))[1])
    rig.round()
    assert len(sent_s) == 1, "a round's frames are handed over together"
    assert min(s for s in looked_s if s > sent_s[0]) - sent_s[0] >= 6 * 135e-6
