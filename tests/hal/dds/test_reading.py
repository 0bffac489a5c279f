"""From LowStates to values by joint: nothing is invented, whatever arrives."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds")

from core.config import config_file, load_options
from hal.dds.layout import CMD, STATE
from hal.dds.options import DdsOptions
from hal.dds.remote import Remote, decode_remote, encode_remote
from hal.dds.slots import SLOT_NAMES, SlotMap
from hal.dds.state_writer import StateWriter
from hal.dds.tick_clock import TickClock, went_back
from hal.wire.boards import StateBoard, is_complete
from tests.hal.dds.test_types import some_command, some_state
from tests.hal.rigs import G1

OPTIONS = load_options(DdsOptions, config_file("hal", "dds"))
SLOTS = SlotMap(G1, OPTIONS.held)


def board() -> StateBoard:
    return StateBoard(memoryview(bytearray(StateBoard.size(G1.num_joints))), G1.num_joints)


def writer(onto: StateBoard, *, ticks: bool = False) -> StateWriter:
    return StateWriter(onto, SLOTS, TickClock(usable=ticks), 5)


def healthy(tick: int = 1000) -> np.ndarray:
    message = some_state()
    message["tick"], message["mode_pr"], message["motor_state"]["motorstate"] = tick, 0, 0
    message["wireless_remote"] = 0
    return message


def test_values_arrive_at_their_joints_by_name() -> None:
    message, onto = healthy(), board()
    motors = message["motor_state"]
    for slot, name in enumerate(SLOT_NAMES):
        motors["q"][slot] = sum(map(ord, name)) / 1000
        motors["temperature"][slot] = slot, 2 * slot
    motors["temperature"][4] = 90, 20
    writer(onto).hear(message, 3.5)
    seen = onto.snapshot()
    assert seen is not None and is_complete(seen)
    expected = [sum(map(ord, name)) / 1000 for name in G1.joint_names]
    np.testing.assert_allclose(seen.joint_pos_rad, expected, rtol=1e-6)
    # Slots of the 23 joints on a 29-motor robot.
    places = [*range(19), 22, 23, 24, 25]
    np.testing.assert_array_equal(seen.joint_vel_rad_s, motors["dq"][places].astype(float))
    np.testing.assert_array_equal(seen.joint_torque_nm, motors["tau_est"][places].astype(float))
    hottest = [90.0 if slot == 4 else 2.0 * slot for slot in places]
    np.testing.assert_array_equal(seen.temperature_c, hottest)
    assert (seen.joint_stamp_s == 3.5).all() and seen.imu_stamp_s == 3.5
    np.testing.assert_array_equal(seen.imu_quat_wxyz, message["imu_state"]["quaternion"].astype(float))
    np.testing.assert_array_equal(seen.imu_acc_b, message["imu_state"]["accelerometer"].astype(float))
    assert onto.texts() == ((), ())


def test_a_disconnected_motor_keeps_its_last_value_and_its_age_grows() -> None:
    onto, before = board(), healthy()
    to = writer(onto)
    to.hear(before, 1.0)
    knee = SLOT_NAMES.index("left_knee_joint")
    after = healthy(1010)
    after["motor_state"]["q"] += 0.5
    after["motor_state"]["motorstate"][knee] = 0x80000000
    to.hear(after, 1.01)
    seen = onto.snapshot()
    joint = G1.joint_names.index("left_knee_joint")
    assert seen.joint_pos_rad[joint] == float(before["motor_state"]["q"][knee])
    assert seen.joint_stamp_s[joint] == 1.0
    assert (np.delete(seen.joint_stamp_s, joint) == 1.01).all()
    assert onto.texts()[0] == ("motor_fault:left_knee_joint: disconnected",)
    to.hear(healthy(1020), 1.02)
    assert onto.texts()[0] == ()
    assert (onto.snapshot().joint_stamp_s == 1.02).all()


def test_motor_faults_are_shown_in_words_also_those_of_held_joints() -> None:
    onto, message = board(), healthy()
    message["motor_state"]["motorstate"][[0, 27]] = 0x1 | 0x200, 0x100000
    writer(onto).hear(message, 1.0)
    assert onto.texts()[0] == (
        "motor_fault:left_hip_pitch_joint: overcurrent, winding too hot",
        "motor_fault:right_wrist_pitch_joint: bits 0x100000",
    )


def test_a_command_time_out_counts_only_while_we_command() -> None:
    onto, message = board(), healthy()
    message["motor_state"]["motorstate"] = 0x40000000
    to = writer(onto)
    to.hear(message, 1.0)
    assert onto.texts()[0] == ()
    to.commanding_since_s = 1.0
    to.hear(message, 1.4)
    assert onto.texts()[0] == ()
    to.hear(message, 1.6)
    assert onto.texts()[0] == ("the robot hears no commands",)


def test_a_restart_and_another_machine_latch() -> None:
    onto = board()
    to = writer(onto)
    to.hear(healthy(5000), 1.0)
    restarted = healthy(20)
    restarted["mode_machine"] = 4
    to.hear(restarted, 2.0)
    to.hear(healthy(40), 2.02)
    lost = "restarted: its own controller may drive the robot: end this run, begin another"
    assert set(onto.texts()[0]) == {"mode_machine is no longer 5", lost} and to.lost == lost
    to.acknowledge()
    assert onto.texts()[0] == (lost,)


def test_a_message_that_was_overtaken_latches_and_ends_nothing() -> None:
    onto = board()
    to = writer(onto)
    for tick in (5000, 4980, 5002):
        to.hear(healthy(tick), 1.0)
    assert onto.texts()[0] == ("LowState's tick went back",) and to.lost is None
    to.acknowledge()
    assert onto.texts()[0] == ()


def test_the_remote_is_passed_on_and_an_absent_one_is_not_heard() -> None:
    onto, message = board(), healthy()
    to = writer(onto)
    to.hear(message, 1.0)
    assert onto.snapshot().remote_stamp_s == -np.inf
    message["wireless_remote"][2:4] = 0b00000101, 0b00000010
    to.hear(message, 2.0)
    assert onto.snapshot().remote_stamp_s == 2.0
    assert onto.texts()[1] == ("B", "R1", "start") and not onto.snapshot().remote_sticks.any()
    message["wireless_remote"] = np.frombuffer(encode_remote(Remote((), 0.5, -0.5, 1.0, 0.25)), np.uint8)
    to.hear(message, 3.0)
    assert onto.snapshot().remote_sticks.tolist() == [0.5, -0.5, 1.0, 0.25]


LOW_BYTE = ("R1", "L1", "start", "select", "R2", "L2", "F1", "F2")
HIGH_BYTE = ("A", "B", "X", "Y", "up", "right", "down", "left")


@pytest.mark.parametrize("bit", range(8))
@pytest.mark.parametrize(("place", "names"), [(2, LOW_BYTE), (3, HIGH_BYTE)])
def test_each_button_has_its_bit(place: int, names: tuple[str, ...], bit: int) -> None:
    data = bytearray(40)
    data[place] = 1 << bit
    remote = decode_remote(bytes(data))
    assert remote is not None and remote.buttons == (names[bit],)


def test_sticks() -> None:
    data = bytearray(40)
    # 0.5, -1.0, 0.25 and -0.75 as little-endian floats: lx, rx, ry at 4, 8, 12 and ly at 20.
    data[4:8], data[8:12] = bytes.fromhex("0000003f"), bytes.fromhex("000080bf")
    data[12:16], data[20:24] = bytes.fromhex("0000803e"), bytes.fromhex("000040bf")
    assert decode_remote(bytes(data)) == Remote((), left_x=0.5, left_y=-0.75, right_x=-1.0, right_y=0.25)
    assert decode_remote(encode_remote(Remote(("A", "L2"), 0.5, -0.5, 1.0, 0.0))) == Remote(
        ("L2", "A"), 0.5, -0.5, 1.0, 0.0
    )
    assert decode_remote(bytes(40)) is None
    with pytest.raises(ValueError, match="39 bytes"):
        decode_remote(bytes(39))


def test_ages_by_the_robots_tick_show_a_delay() -> None:
    clock = TickClock(usable=True)
    for i in range(100):
        assert clock.measured_s(5000 + 2 * i, 10.0 + 0.002 * i) == pytest.approx(10.0 + 0.002 * i)
    # From now on everything comes 30 ms late, then one by one as it should again.
    late_s = clock.measured_s(5200, 10.2 + 0.03)
    assert 10.23 - late_s == pytest.approx(0.03, abs=1e-3)
    assert clock.measured_s(5300, 10.3) == pytest.approx(10.3)


def test_a_quicker_way_corrects_what_was_taken_for_no_delay() -> None:
    clock = TickClock(usable=True)
    assert clock.measured_s(1000, 1.05) == pytest.approx(1.05)
    assert clock.measured_s(1010, 1.01) == pytest.approx(1.01)
    assert clock.measured_s(1020, 1.05) == pytest.approx(1.02, abs=1e-3)


def test_clocks_that_run_apart_make_no_age() -> None:
    clock = TickClock(usable=True)
    for i in range(0, 600_000, 50):
        arrival_s = 1e-3 * i * 1.0005
        assert arrival_s - clock.measured_s(i, arrival_s) < 1e-3


def test_a_restart_begins_a_new_reckoning() -> None:
    clock = TickClock(usable=True)
    clock.measured_s(100_000, 1.0)
    assert clock.measured_s(10, 2.0) == pytest.approx(2.0)
    assert went_back(10, 100_000) and not went_back(3, 2**32 - 5)


@pytest.mark.parametrize(("rate", "usable"), [(1.0, True), (1.1, True), (0.5, False), (2.0, False), (0.0, False)])
def test_ticks_are_used_where_they_are_milliseconds(rate: float, usable: bool) -> None:
    arrivals_s = [0.002 * i for i in range(150)]
    clock = TickClock.fitted([int(1e3 * rate * s) for s in arrivals_s], arrivals_s)
    assert clock.usable is usable
    assert TickClock.fitted([1, 2], [0.0, 0.002]).usable is False
    if not usable:
        assert clock.measured_s(7, 3.3) == 3.3


@pytest.mark.parametrize(("layout", "some"), [(STATE, some_state), (CMD, some_command)], ids=["state", "command"])
def test_fuzz_mutated_messages_are_refused(layout: object, some: object) -> None:
    rng = np.random.default_rng(3)
    message = some()
    body = layout.to_body(message)
    places = rng.integers(0, 8 * len(body), (100_000, 3))
    counts = rng.integers(1, 4, 100_000)
    accepted = 0
    for flips, count in zip(places.tolist(), counts.tolist()):
        mutated = bytearray(body)
        for bit in set(flips[:count]):
            mutated[bit >> 3] ^= 1 << (bit & 7)
        seen = layout.from_body(bytes(mutated))
        if layout.intact(seen):
            accepted += 1
            assert seen == message
    # What is accepted differs in padding only: 105 of 2088 bytes, 105 of 1000.
    assert accepted < 0.1 * 100_000


def test_fuzz_other_lengths_and_random_bodies_are_refused() -> None:
    rng = np.random.default_rng(4)
    for size in rng.integers(0, 4000, 10_000).tolist():
        data = rng.bytes(size)
        for layout in (STATE, CMD):
            seen = layout.from_body(data)
            assert (seen is None) == (size != layout.body_bytes)
            assert seen is None or not layout.intact(seen)
    for _ in range(10_000):
        assert not STATE.intact(STATE.from_body(rng.bytes(2088)))


def test_fuzz_whatever_a_robot_says_is_passed_on_and_nothing_else() -> None:
    rng = np.random.default_rng(5)
    onto = board()
    to = writer(onto, ticks=True)
    with np.errstate(invalid="ignore"):
        for i in range(10_000):
            message = STATE.from_body(rng.bytes(2088))
            if i % 100:
                message["motor_state"]["motorstate"] = 0
            to.hear(message, 0.002 * i)
            if i % 10 == 0:
                seen = onto.snapshot()
                fresh = message["motor_state"]["motorstate"][SLOTS.robot] & 0x80000000 == 0
                said = message["motor_state"]["q"][SLOTS.robot].astype(float)
                np.testing.assert_array_equal(seen.joint_pos_rad[fresh], said[fresh])
                assert (seen.joint_stamp_s <= 0.002 * i).all()
