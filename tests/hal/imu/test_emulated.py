"""Reader and emulated IMU together, over a pseudo-terminal."""

import dataclasses
import time
from typing import cast

import numpy as np
import pytest

from core.config import config_file, load_options
from core.rotations import projected_gravity
from hal.emulator.faults import COMMON_KINDS, Faults
from hal.emulator.imu import IMU_FAULTS, ImuLine
from hal.emulator.robot import EmulatedRobot
from hal.imu.options import ImuOptions
from hal.imu.reader import ImuReader, ImuReading
from world.plant import Measurement

LEAN = np.array([np.cos(0.2), 0.0, np.sin(0.2), 0.0])  # 0.4 rad forward, about y


class LeaningRobot:
    """At rest, leaning forward: gravity pulls along +x of the base, so the specific force has a part along -x."""

    def measure(self) -> Measurement:
        zero = np.zeros(1)
        acc_b = 9.81 * np.array([-np.sin(0.4), 0.0, np.cos(0.4)])
        return Measurement(time.monotonic(), zero, zero, zero, LEAN, np.array([0.1, -0.2, 0.3]), acc_b)


def newest(reader: ImuReader, reached, limit_s: float = 10.0) -> ImuReading:
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        reading = reader.poll(time.monotonic())
        if reading is not None and reached(reading):
            return reading
        time.sleep(0.002)
    raise AssertionError("no such reading")


@pytest.fixture(params=["imu_hipnuc", "imu_witmotion"])
def pair(request: pytest.FixtureRequest):
    faults = Faults(kinds={**COMMON_KINDS, **IMU_FAULTS})
    options = load_options(ImuOptions, config_file("hal", request.param))
    line = ImuLine(cast(EmulatedRobot, LeaningRobot()), faults, options)
    line.start()
    # A promise of 10 Hz is kept by the hundreds that are sent, however busy the machine.
    reader = ImuReader(dataclasses.replace(options, port=line.path, rate_hz=10.0))
    yield reader, faults
    reader.close()
    line.stop()


def test_axes_and_units_survive_wire_and_mounting(pair) -> None:
    reader, _ = pair
    assert reader.options.protocol in reader.identify(10.0)
    reading = newest(reader, lambda _: True)
    assert reading.quat_wxyz == pytest.approx(LEAN, abs=1e-3)
    assert reading.ang_vel_b == pytest.approx([0.1, -0.2, 0.3], abs=2e-3)
    assert reading.acc_b == pytest.approx([-3.8202, 0.0, 9.0356], abs=6e-3)
    # What preflight looks at: the specific force points against gravity, and is as large.
    assert reading.acc_b / 9.81 == pytest.approx(-projected_gravity(reading.quat_wxyz), abs=2e-3)


def test_wrong_units_and_a_wrong_orientation_show_against_gravity(pair) -> None:
    reader, faults = pair
    reader.identify(10.0)
    faults.add("imu_units")
    newest(reader, lambda reading: abs(np.linalg.norm(reading.acc_b) - 1.0) < 0.02)
    faults.clear()
    faults.add("imu_tilt", value=0.3)

    def leans(reading: ImuReading) -> bool:
        up = -projected_gravity(reading.quat_wxyz)
        angle = np.arccos(np.clip(reading.acc_b @ up / np.linalg.norm(reading.acc_b), -1, 1))
        return bool(abs(angle - 0.3) < 0.02)

    newest(reader, leans)


def test_silence_ages_and_corrupt_frames_are_refused(pair) -> None:
    reader, faults = pair
    reader.identify(10.0)
    faults.add("silence")
    time.sleep(0.2)
    reader.poll(time.monotonic())
    time.sleep(0.1)
    assert reader.poll(time.monotonic()) is None
    faults.clear()
    newest(reader, lambda _: True)
    faults.add("corrupt")
    before = reader.bad_frames
    end_s = time.monotonic() + 10.0
    while reader.bad_frames == before and time.monotonic() < end_s:
        reader.poll(time.monotonic())
        time.sleep(0.002)
    assert reader.bad_frames > before


def test_an_adapter_that_comes_back_is_read_again(pair) -> None:
    reader, faults = pair
    reader.identify(10.0)
    faults.add("reconnect")
    end_s = time.monotonic() + 10.0
    while reader.is_open and time.monotonic() < end_s:
        reader.poll(time.monotonic())
        time.sleep(0.002)
    assert not reader.is_open
    faults.clear()
    newest(reader, lambda _: True)
