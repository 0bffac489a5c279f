"""Both ends for real: the driver here, the strict robot in a process of its own, frames over loopback."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds")

from core.clock import MonotonicClock
from core.config import config_file
from hal.contract.types import DeviceFault, LinkLost
from hal.dds.driver import DdsDriver
from hal.emulator import control, launch
from hal.emulator.launch import Emulator, launch_emulator
from hal.wire.backend import WireBackend
from hal.wire.driver import WireFactory
from tests.hal.dds.host import LIMIT_S, Host, driver_for, wait
from tests.hal.rigs import G1


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulator]:
    """A robot that speaks at 100 Hz: a quarter of the work, and nothing here is about rates."""
    file = tmp_path_factory.mktemp("dds") / "slow.yaml"
    file.write_text(config_file("hal", "dds").read_text().replace("state_hz: 500.0", "state_hz: 100.0"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launch, "START_LIMIT_S", 2 * LIMIT_S)
        patch.setattr(control, "TIMEOUT_S", LIMIT_S)
        with launch_emulator("dds", file) as emulator:
            yield emulator


@pytest.fixture
def emulator(started: Emulator) -> Emulator:
    started.control.clear_fault()
    started.control.reset()
    started.control.device(buttons=[])
    started.control.device(sticks=[0, 0, 0, 0])
    started.control.device(release_s=0.2)
    return started


def status(emulator: Emulator) -> dict[str, Any]:
    return emulator.control.status()


def counts(emulator: Emulator) -> dict[str, int]:
    return status(emulator)["device"]["counts"]


def opened_and_refused(emulator: Emulator, **changes: Any) -> None:
    driver = driver_for(emulator, **changes)
    try:
        driver.identify()
    finally:
        driver.close()


def test_looking_commands_nothing_and_releases_nothing(emulator: Emulator) -> None:
    with Host(emulator) as host:
        assert host.info.joint_names == G1.joint_names
        assert host.info.details["motion service"].startswith("'ai' is active")
        assert host.info.details["mode_machine"] == "5"
        time.sleep(0.2)
        seen = host.seen()
        assert abs(np.linalg.norm(seen.imu_quat_wxyz) - 1) < 1e-3
        assert (seen.joint_stamp_s <= time.monotonic()).all()
    device = status(emulator)["device"]
    assert device["motion_service"] == "ai"
    assert set(device["counts"]) <= {"lowstate sent"}
    assert set(status(emulator)["mode"].values()) == {"slack"}


def test_the_service_lets_go_first_and_joints_follow_by_name(emulator: Emulator) -> None:
    with Host(emulator) as host:
        host.enable()
        assert status(emulator)["device"]["motion_service"] == ""
        elbow = G1.joint_names.index("right_elbow_joint")
        start = host.seen().joint_pos_rad
        target = start.copy()
        target[elbow] += 0.4
        host.hold(target, lambda: host.seen().joint_pos_rad[elbow] > start[elbow] + 0.2)
        others = np.delete(np.abs(host.seen().joint_pos_rad - start), elbow)
        assert others.max() < 0.15
        assert status(emulator)["joint_pos_rad"]["right_elbow_joint"] > start[elbow] + 0.15
        # The wrists were found at 0.2 rad and are brought to 0 while tracking.
        host.hold(target, lambda: max(map(abs, status(emulator)["device"]["held_rad"].values())) < 0.1)
        assert host.errors == []
    after = status(emulator)
    assert after["violations"]["counts"].keys() <= {"torque"}
    assert after["device"]["held_violations"] == []
    assert set(after["device"]["counts"]) == {"obeyed", "lowstate sent"}
    assert set(after["mode"].values()) == {"slack"}


def test_a_service_that_never_lets_go_is_refused_by_name_and_nothing_is_sent(emulator: Emulator) -> None:
    emulator.control.device(release_s=3600.0)
    with Host(emulator, release_s=0.5) as host:
        with pytest.raises(DeviceFault, match=r"the motion service keeps mode 'ai' after 0\.5 s of asking"):
            host.enable()
        host.damp()
        time.sleep(0.2)
        assert set(counts(emulator)) == {"lowstate sent"}
        emulator.control.device(release_s=0.2)
        host.driver.acknowledge()
        wait(lambda: set(status(emulator)["mode"].values()) == {"damped"})
        assert set(counts(emulator)) == {"lowstate sent", "obeyed"}


def test_damping_is_heard_before_enabling_has_ended(emulator: Emulator) -> None:
    """A released robot is limp: it need not wait until the loop commands."""
    with Host(emulator) as host:
        host.driver.enable()
        assert not host.outbox.energised
        wait(lambda: set(status(emulator)["mode"].values()) == {"damped"})
        host.enable()


def sent_from_now_on(emulator: Emulator, seconds: float = 0.3) -> int:
    """How many LowCmds reach the robot, obeyed or not, in so many seconds."""
    before = counts(emulator)
    time.sleep(seconds)
    after = counts(emulator)
    return sum(after[name] - before.get(name, 0) for name in after if name != "lowstate sent")


def test_a_service_that_is_active_again_keeps_the_robot(emulator: Emulator) -> None:
    """Somebody has stood the robot up by its remote: acknowledging an older fault must not let it fall."""
    with Host(emulator) as host:
        host.enable()
        host.damp()
        wait(lambda: set(status(emulator)["mode"].values()) == {"damped"})
        emulator.control.device(motion_service="ai")
        host.driver.acknowledge()
        assert any("the motion service is active again" in fault for fault in host.faults)
        wait(lambda: sent_from_now_on(emulator) == 0)
        host.driver.acknowledge()
        assert status(emulator)["device"]["motion_service"] == "ai"
        assert sent_from_now_on(emulator) == 0


def test_a_robot_that_restarted_before_it_was_taken_is_left_to_its_service(emulator: Emulator) -> None:
    """Damping is all that an operator may ask for then; it would release the service of a robot that stands."""
    with Host(emulator) as host:
        emulator.control.fault("brown_out", "lowstate", duration_s=0.3)
        wait(lambda: any("restarted" in fault for fault in host.faults))
        with pytest.raises(DeviceFault, match="restarted: its own controller may drive the robot"):
            host.driver.enable()
        host.outbox.energise()  # as the wire process does after every attempt
        host.damp()
        assert sent_from_now_on(emulator) == 0 and status(emulator)["device"]["motion_service"] == "ai"
        assert not host.outbox.energised


def closed(emulator: Emulator, *, hand_back: bool) -> dict[str, Any]:
    """A run of the whole backend that damps, and what the robot says once it is over."""
    factory = WireFactory(DdsDriver, driver_for(emulator)._options)
    times: dict[str, Any] = {"control_period_s": 0.1, "link_timeout_s": 5.0}
    with WireBackend("dds", G1, MonotonicClock(), factory, **times) as backend:
        backend.damp()
        wait(lambda: set(status(emulator)["mode"].values()) == {"damped"})
        if hand_back:
            backend.hand_back()
    return status(emulator)


def test_the_onboard_controller_has_the_robot_again_where_that_is_asked_for(
    emulator: Emulator, capfd: pytest.CaptureFixture[str]
) -> None:
    told = closed(emulator, hand_back=True)
    assert told["device"]["motion_service"] == "ai"
    # It was asked after the last command: none was refused because the service drove.
    assert "motion service active" not in told["device"]["counts"]
    assert told["device"]["selected_at_rest"] == [True]
    assert "handed back: the motion service drives in mode 'ai'" in capfd.readouterr().err


def test_the_onboard_controller_stays_off_otherwise(emulator: Emulator) -> None:
    told = closed(emulator, hand_back=False)
    assert told["device"]["motion_service"] == "" and told["device"]["selected_at_rest"] == []


def test_without_new_commands_every_motor_is_damped(emulator: Emulator) -> None:
    with Host(emulator) as host:
        host.enable()
        host.hold(host.seen().joint_pos_rad, lambda: "driven" in status(emulator)["mode"].values())
        wait(lambda: set(status(emulator)["mode"].values()) == {"damped"})
        assert host.outbox.latched


@pytest.mark.parametrize(
    ("kind", "key", "reason"),
    [
        ("wrong_id", "lowstate", "mode_machine 4 is a G1 without waist roll and pitch"),
        ("corrupt", "lowstate", "bad checksum"),
        ("tick_stands", "lowstate", "tick stands still; new LowStates come at 0 Hz, 100 Hz expected"),
        ("parallel_mode", "lowstate", "mode_pr"),
        ("silence", "left_knee_joint", "missing motors: left_knee_joint"),
    ],
)
def test_an_unfit_robot_is_refused_with_the_reason(emulator: Emulator, kind: str, key: str, reason: str) -> None:
    emulator.control.fault(kind, key)
    time.sleep(0.1)
    patient = {"state_wait_s": 2.0} if kind == "tick_stands" else {}  # a rate of 0 is waited for
    with pytest.raises(DeviceFault, match=reason):
        opened_and_refused(emulator, **patient)


def test_the_makers_simulator_is_refused_unless_it_is_named(emulator: Emulator) -> None:
    """It leaves checksum, mode_machine and tick at 0."""
    emulator.control.fault("unfilled", "lowstate")
    time.sleep(0.2)
    with pytest.raises(DeviceFault, match="bad checksum"):
        opened_and_refused(emulator)
    with Host(emulator, peer="simulator") as host:
        assert "checksum, mode_machine, tick and rate are not checked" in host.info.details["peer"]
        stamp_s = host.seen().imu_stamp_s
        wait(lambda: host.seen().imu_stamp_s > stamp_s)
        host.enable()
        host.damp()
        wait(lambda: set(status(emulator)["mode"].values()) == {"damped"})
        assert host.faults == () and "wrong mode_machine" not in counts(emulator)


@pytest.mark.parametrize(("kind", "reason"), [("corrupt", "bad checksum"), ("parallel_mode", "mode_pr")])
def test_nothing_else_is_waived_for_a_simulator(emulator: Emulator, kind: str, reason: str) -> None:
    emulator.control.fault(kind, "lowstate")
    time.sleep(0.2)
    with pytest.raises(DeviceFault, match=reason):
        opened_and_refused(emulator, peer="simulator")


def test_a_silent_robot_is_said_to_be_silent(emulator: Emulator) -> None:
    emulator.control.fault("silence", "lowstate")
    time.sleep(0.1)
    with pytest.raises(LinkLost, match=r"silent robot: no LowState within 0\.4 s, domain"):
        opened_and_refused(emulator, state_wait_s=0.4)


def test_a_robot_of_which_little_is_heard_is_not_judged(emulator: Emulator) -> None:
    emulator.control.fault("drop", "lowstate", value=0.97)
    time.sleep(0.1)
    with pytest.raises(LinkLost, match=r"silent robot: \w+ LowState within 0\.2 s"):
        opened_and_refused(emulator, state_wait_s=0.2, observe_s=0.1)


def test_a_robot_that_is_heard_less_often_than_promised_is_refused(emulator: Emulator) -> None:
    """It sends 100 Hz: enough where 120 are promised, of which 96 are 80 %, and too few where 150 are."""
    with Host(emulator, state_hz=120.0) as host:
        assert float(host.info.details["states"].removesuffix(" Hz")) == pytest.approx(100.0, abs=5.0)
    with pytest.raises(DeviceFault, match=r"refused, domain \d+ on lo: new LowStates come at \d+ Hz, 150 Hz expected"):
        opened_and_refused(emulator, state_hz=150.0, state_wait_s=1.0)


def test_a_second_controller_is_refused_before(emulator: Emulator) -> None:
    emulator.control.fault("second_controller", "lowstate")
    time.sleep(0.1)
    with pytest.raises(DeviceFault, match="second controller"):
        opened_and_refused(emulator, motion_service="none")


def test_a_second_controller_that_stays_is_found_when_taking_over(emulator: Emulator) -> None:
    with Host(emulator) as host:
        emulator.control.fault("second_controller", "lowstate")
        time.sleep(0.1)
        with pytest.raises(DeviceFault, match="second controller"):
            host.enable()
        emulator.control.clear_fault()
        time.sleep(0.1)
        host.driver.acknowledge()
        assert host.faults == ()
        wait(lambda: set(status(emulator)["mode"].values()) == {"damped"})


def test_a_second_controller_is_seen_while_we_command(emulator: Emulator) -> None:
    with Host(emulator) as host:
        host.enable()
        host.damp()
        wait(lambda: counts(emulator).get("obeyed", 0))
        assert host.faults == ()
        emulator.control.fault("second_controller", "lowstate")
        wait(lambda: any("second controller" in fault for fault in host.faults))
        emulator.control.clear_fault()
        time.sleep(0.3)
        host.driver.acknowledge()
        assert host.faults == ()


def test_what_is_sent_while_the_service_drives_is_not_obeyed(emulator: Emulator) -> None:
    with Host(emulator, motion_service="none") as host:
        host.enable()
        host.damp()
        wait(lambda: counts(emulator).get("motion service active", 0) > 5)
        assert "obeyed" not in counts(emulator)


@pytest.mark.parametrize(
    ("kind", "key", "shown"),
    [
        ("fault_code", "left_knee_joint", "motor_fault:left_knee_joint: overcurrent"),
        ("silence", "waist_yaw_joint", "motor_fault:waist_yaw_joint: disconnected"),
        ("brown_out", "right_elbow_joint", "motor_fault:right_elbow_joint: disconnected"),
        ("parallel_mode", "lowstate", "mode_pr"),
        ("wrong_id", "lowstate", "mode_machine is no longer 5"),
    ],
)
def test_faults_of_a_running_robot_are_shown(emulator: Emulator, kind: str, key: str, shown: str) -> None:
    with Host(emulator) as host:
        assert host.faults == ()
        emulator.control.fault(kind, key)
        wait(lambda: any(shown in fault for fault in host.faults))


def test_a_motor_without_power_stays_slack_until_it_is_told_mode_0(emulator: Emulator) -> None:
    with Host(emulator) as host:
        host.enable()
        host.damp()
        wait(lambda: set(status(emulator)["mode"].values()) == {"damped"})
        emulator.control.fault("brown_out", "left_knee_joint")
        wait(lambda: status(emulator)["mode"]["left_knee_joint"] == "slack")
        emulator.control.clear_fault()
        wait(lambda: "motor_fault:left_knee_joint: reset" in host.faults)
        assert status(emulator)["mode"]["left_knee_joint"] == "slack"
    with Host(emulator) as host:
        assert host.faults == ()


def test_wrong_checksums_renew_nothing_and_are_counted(emulator: Emulator) -> None:
    with Host(emulator) as host:
        emulator.control.fault("corrupt", "lowstate")
        wait(lambda: host.state.all_stats().get("lowstate bad_checksum", 0) > 10)
        stamp_s = host.seen().imu_stamp_s
        wait(lambda: host.state.all_stats()["lowstate bad_checksum"] > 20)
        assert host.seen().imu_stamp_s == stamp_s


def test_a_delay_shows_as_age(emulator: Emulator) -> None:
    with Host(emulator) as host:
        if host.info.details["ages"] != "by the robot's tick":
            pytest.skip("this machine was too busy to recognise the robot's milliseconds")
        arrivals = host.driver._states
        emulator.control.fault("delay", "lowstate", value=0.3)
        time.sleep(1.0)

        def age_s() -> float:
            stamp_s, (_, arrived_s) = host.seen().imu_stamp_s, arrivals.latest
            return arrived_s - stamp_s

        wait(lambda: age_s() > 0.25)


def test_temperatures_and_the_remote_arrive(emulator: Emulator) -> None:
    with Host(emulator) as host:
        emulator.control.fault("over_temperature", "left_knee_joint", value=105.0)
        emulator.control.device(buttons=["B", "L1"])
        knee = G1.joint_names.index("left_knee_joint")
        wait(lambda: host.seen().temperature_c[knee] == 105.0)
        wait(lambda: host.state.texts()[1] == ("B", "L1"))
        assert host.seen().remote_stamp_s > 0
        emulator.control.device(sticks=[0.5, -0.25, 1, 0])
        wait(lambda: host.seen().remote_sticks.tolist() == [0.5, -0.25, 1.0, 0.0])
        assert host.state.texts()[1] == ("B", "L1")


def test_the_state_of_charge_arrives(emulator: Emulator) -> None:
    with Host(emulator) as host:
        wait(lambda: host.seen().charge == 0.8)
        emulator.control.fault("battery_low", "lowstate", value=19.0)
        wait(lambda: host.seen().charge == 0.19)
        assert host.state.all_stats()["battery charge %"] == 19.0 and np.isnan(host.seen().supply)


def test_a_robot_that_loses_power_comes_back_under_its_own_service(emulator: Emulator) -> None:
    with Host(emulator) as host:
        host.enable()
        host.damp()
        wait(lambda: counts(emulator).get("obeyed", 0))
        emulator.control.fault("brown_out", "lowstate", duration_s=0.3)
        wait(lambda: any("restarted" in fault for fault in host.faults))
        assert status(emulator)["device"]["motion_service"] == "ai"
        wait(lambda: set(status(emulator)["mode"].values()) == {"slack"})
        wait(lambda: sent_from_now_on(emulator) == 0)
        host.driver.acknowledge()
        assert status(emulator)["device"]["motion_service"] == "ai" and sent_from_now_on(emulator) == 0
        assert any("restarted" in fault for fault in host.faults)


def test_a_configuration_that_leaves_motors_out_is_refused(tmp_path: Path) -> None:
    from hal.dds.driver import make_factory

    file = tmp_path / "short.yaml"
    lines = config_file("hal", "dds").read_text().splitlines()
    file.write_text("\n".join(line for line in lines if "left_wrist_roll" not in line))
    with pytest.raises(ValueError, match="motors that nobody holds"):
        make_factory(file, {"interface": "lo"})(G1)
