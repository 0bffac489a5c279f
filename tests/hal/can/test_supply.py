"""The supply voltage of motors that must be asked for it: who is asked when, and what becomes of the answers."""

import math

import pytest

from hal.can import supply
from hal.can.codec import SUPPLY_V, MotorCommand
from hal.can.frame import Frame
from hal.can.motor import Motor
from hal.can.supply import BusSupply
from tests.hal.can.rig import ANKLE, ELBOW, HIP, KNEE, Rig, motor, robot_file

# Motors 11 and 12 are RobStride: type 17, host FD, parameter 701Ch.
ASKED = {
    joint: Frame(0x1100_FD00 | k, bytes.fromhex("1C70000000000000"), extended=True)
    for joint, k in ((HIP, 11), (KNEE, 12))
}
ARMS = (
    motor(HIP, 11, codec="robstride", model="RS06"),
    motor(KNEE, 12, codec="robstride", model="RS04"),
    motor(ELBOW, 3),
)


def motors(*entries):
    file = robot_file(*entries)
    return [Motor(entry.joint, row, codec, 1.0) for row, (entry, codec) in enumerate(zip(file.motors, file.codecs))]


@pytest.fixture
def impatient(monkeypatch):
    """Every round asks somebody."""
    monkeypatch.setattr(supply, "ASK_PERIOD_S", 0.0)


def test_one_motor_after_the_other_is_asked_every_fifth_of_a_second():
    bus = BusSupply(motors(*ARMS), 48.0)
    asked = {tick: bus.question(tick / 128) for tick in range(128)}
    when = {tick: frames for tick, frames in asked.items() if frames}
    assert list(when) == [0, 26, 52, 78, 104]
    assert list(when.values()) == [(ASKED[joint],) for joint in (KNEE, HIP, KNEE, HIP, KNEE)]


@pytest.mark.parametrize(("entries", "nominal_v"), [(ARMS, None), ((motor(HIP, 1), motor(KNEE, 2)), 48.0)])
def test_nobody_is_asked_in_vain(entries, nominal_v):
    """Without a voltage to judge by, or of motors that do not know."""
    bus = BusSupply(motors(*entries), nominal_v)
    assert not any(bus.question(float(now_s)) for now_s in range(9))


def test_the_lowest_and_the_highest_motor_of_the_bus_are_shown(impatient):
    rig = Rig(robot_file(*ARMS, supply_v=50.0))
    rig.faults.add("supply", HIP, value=40.0)
    rig.faults.add("supply", KNEE, value=60.0)
    rig.begin()
    rig.round(6)
    state = rig.board.snapshot()
    assert (state.supply, state.supply_high) == pytest.approx((0.8, 1.2))
    stats = rig.board.all_stats()
    assert (stats["battery supply %"], stats["battery highest supply %"]) == pytest.approx((80.0, 120.0))


def test_answers_about_the_supply_are_no_answers_to_commands(impatient):
    """A motor that says nothing else is missed, and its state grows old."""
    rig = Rig(robot_file(*ARMS, supply_v=48.0))
    rig.begin()
    rig.round(8)
    knee = rig.bus.motors[1]
    assert [one.missed for one in rig.bus.motors] == [1, 1, 1]  # before the first round
    assert len(knee.unanswered) == 0
    stamp_s = knee.stamp_s
    hear = rig.motors[1].hear
    rig.motors[1].hear = lambda frame, now_s: hear(frame, now_s) if frame == ASKED[KNEE] else ()
    rig.round(8)
    assert knee.missed > 4 and knee.stamp_s == stamp_s and knee.supply_v == 48.0


def test_a_motor_that_refuses_the_question_or_says_no_number_shows_nothing():
    for data in ("1C70000000000000", "1C7000000000C07F"):
        rig = Rig(robot_file(*ARMS, supply_v=48.0))
        rig.begin()
        refused = 0x0001_0000 if data.endswith("00") else 0
        rig.bus.take(Frame(0x1100_0BFD | refused, bytes.fromhex(data), extended=True), 0.0)
        assert rig.board.snapshot() is None or math.isnan(rig.board.snapshot().supply)
        assert math.isnan(rig.bus.motors[0].supply_v)


def test_moteus_is_asked_in_a_frame_of_its_own(impatient):
    pytest.importorskip("moteus", reason="the extra moteus is not installed")
    options = {"kp_nm_per_turn": 600.0, "kd_nm_s_per_turn": 20.0, "torque_nm": 60.0}
    rig = Rig(robot_file(motor(ANKLE, 1, codec="moteus", model="x1", options=options), supply_v=24.0))
    rig.faults.add("supply", ANKLE, value=30.0)
    rig.begin()
    rig.round(3)
    assert rig.board.snapshot().supply_high == pytest.approx(1.25)
    questions = [rig.motors[0].codec.parse_command(frame, MotorCommand()) for frame in rig.link.sent]
    assert [asked.name for asked in questions].count(SUPPLY_V) == 3
