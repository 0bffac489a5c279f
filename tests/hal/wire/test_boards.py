"""States from the wire's threads to the loop."""

import math

import numpy as np
import pytest

from hal.wire.boards import TEXT_BYTES, StateBoard, is_complete


@pytest.fixture
def boards():
    buffer = memoryview(bytearray(StateBoard.size(3)))
    return StateBoard(buffer, 3), StateBoard(buffer, 3)


def test_nothing_has_been_heard_at_first(boards):
    assert boards[1].snapshot() is None and not is_complete(None)
    assert boards[1].texts() == ((), ())


def test_joints_arrive_with_their_own_stamps(boards):
    writer, reader = boards
    writer.joints([2, 0], np.array([1.0, 2.0]), 0.5, np.array([3.0, 4.0]), math.nan, 10.0)
    seen = reader.snapshot()
    np.testing.assert_array_equal(seen.joint_pos_rad, [2.0, np.nan, 1.0])
    np.testing.assert_array_equal(seen.joint_torque_nm, [4.0, np.nan, 3.0])
    np.testing.assert_array_equal(seen.joint_stamp_s, [10.0, -np.inf, 10.0])
    assert not is_complete(seen)
    writer.joints(1, 7.0, 8.0, 9.0, 40.0, 11.0)
    assert not is_complete(reader.snapshot())
    writer.imu(np.array([1.0, 0, 0, 0]), np.array([1.0, 2, 3]), np.array([4.0, 5, 6]), 12.0)
    seen = reader.snapshot()
    assert is_complete(seen) and seen.imu_stamp_s == 12.0
    np.testing.assert_array_equal(seen.imu_ang_vel_b, [1, 2, 3])
    np.testing.assert_array_equal(seen.imu_acc_b, [4, 5, 6])
    np.testing.assert_array_equal(seen.imu_quat_wxyz, [1, 0, 0, 0])
    np.testing.assert_array_equal(seen.temperature_c, [np.nan, 40.0, np.nan])
    assert seen.remote_stamp_s == -math.inf


def test_the_battery_is_unknown_until_it_is_reported_and_the_outermost_supplies_count(boards):
    writer, reader = boards
    writer.joints(slice(None), 1.0, 1.0, 1.0, 1.0, 1.0)
    assert all(math.isnan(getattr(reader.snapshot(), name)) for name in ("charge", "supply", "supply_high"))
    writer.charge(0.8)
    writer.supply("left", 0.9, 1.1)
    writer.supply("right", 1.0, 1.05)
    writer.joints(slice(None), 2.0, 1.0, 1.0, 1.0, 1.0)
    seen = reader.snapshot()
    assert (seen.charge, seen.supply, seen.supply_high) == (0.8, 0.9, 1.1)
    assert (seen.joint_pos_rad == 2.0).all() and math.isinf(seen.remote_stamp_s)
    writer.supply("left", 1.1, 1.3)
    writer.imu(np.ones(4), np.ones(3), np.ones(3), 1.0)
    assert (reader.snapshot().supply, reader.snapshot().supply_high) == (1.0, 1.3)
    stats = {"battery charge %": 80.0, "battery supply %": 100.0, "battery highest supply %": 130.0}
    assert writer.all_stats() == stats


def test_a_snapshot_does_not_change(boards):
    writer, reader = boards
    writer.joints(slice(None), 1.0, 1.0, 1.0, 1.0, 1.0)
    seen = reader.snapshot()
    writer.joints(slice(None), 2.0, 2.0, 2.0, 2.0, 2.0)
    assert (seen.joint_pos_rad == 1.0).all()


def test_faults_come_and_go(boards):
    writer, reader = boards
    writer.fault("b", True)
    writer.fault("a: with a reason", True)
    writer.fault("b", True)
    serial = reader.texts_serial
    assert reader.texts()[0] == ("a: with a reason", "b")
    writer.fault("never", False)
    assert reader.texts_serial == serial
    writer.fault("b", False)
    assert reader.texts()[0] == ("a: with a reason",)


def test_faults_that_cannot_be_had_whole_are_not_taken_for_none(boards, monkeypatch):
    writer, reader = boards
    writer.fault("a", True)
    monkeypatch.setattr(reader._texts, "latest", lambda: None)
    assert reader.texts() is None
    monkeypatch.undo()
    assert reader.texts()[0] == ("a",)


def test_more_faults_than_fit_are_counted(boards):
    writer, reader = boards
    for k in range(200):
        writer.fault(f"{k:03} " + "x" * (TEXT_BYTES // 100), True)
    faults = reader.texts()[0]
    assert faults[0].startswith("000 ") and faults[-1] == f"{200 - (len(faults) - 1)} more faults"


def test_buttons(boards):
    writer, reader = boards
    writer.remote({"B", "A"}, 3.0)
    assert reader.texts()[1] == ("A", "B") and reader.snapshot().remote_stamp_s == 3.0
    serial = reader.texts_serial
    writer.remote(["A", "B"], 4.0)
    assert reader.texts_serial == serial and reader.snapshot().remote_stamp_s == 4.0


def test_sticks_are_beside_the_imu_and_rest_where_none_are_told(boards):
    writer, reader = boards
    writer.remote((), 3.0, (0.5, -0.25, 1.0, -1.0))
    assert reader.snapshot().remote_sticks.tolist() == [0.5, -0.25, 1.0, -1.0] and reader.snapshot().imu_stamp_s < 0.0
    writer.remote((), 4.0)
    assert not reader.snapshot().remote_sticks.any()


def test_figures_for_the_report(boards):
    boards[0].stats("frames.corrupt", 2)
    assert boards[0].all_stats() == {"frames.corrupt": 2}
