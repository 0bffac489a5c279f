"""The reader on a pseudo-terminal: ages, mounting, noise on the line, a port that goes away."""

import math
import os
import time
from pathlib import Path

import numpy as np
import pytest

from core.errors import InputError
from hal.contract.types import DeviceError
from hal.imu import hipnuc
from hal.imu.options import ImuOptions
from hal.imu.reader import ImuReader
from hal.imu.sample import ImuSample, Mounting

pytestmark = pytest.mark.real_time

UPRIGHT = ImuSample((1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3), (0.0, 0.0, 9.80665))


@pytest.fixture
def line():
    """(device's end, options that name the reader's end)."""
    master, slave = os.openpty()
    yield master, ImuOptions("hipnuc", os.ttyname(slave), 921600, 500.0)
    for end in (master, slave):
        os.close(end)


def wait_for(reader: ImuReader, limit_s: float = 5.0):
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        reading = reader.poll(time.monotonic())
        if reading is not None:
            return reading
        time.sleep(0.001)
    raise AssertionError("no reading arrived")


def test_the_newest_sample_wins_and_its_age_is_never_too_low(line) -> None:
    master, options = line
    reader = ImuReader(options)
    reader.open()
    assert reader.poll(time.monotonic()) is None
    looked_s = time.monotonic()
    assert reader.poll(looked_s) is None
    turned = ImuSample((0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665))
    os.write(master, hipnuc.encode(UPRIGHT) + hipnuc.encode(turned))
    reading = wait_for(reader)
    assert reading.quat_wxyz == pytest.approx([0, 1, 0, 0])
    assert reading.stamp_s >= looked_s - 82 * 10 / 921600
    assert reading.stamp_s < time.monotonic() - 82 * 10 / 921600
    assert reader.samples == 2
    reader.close()


def test_half_a_frame_is_no_sample(line) -> None:
    master, options = line
    reader = ImuReader(options)
    reader.open()
    frame = hipnuc.encode(UPRIGHT)
    os.write(master, frame[:60])
    time.sleep(0.01)
    assert reader.poll(time.monotonic()) is None
    os.write(master, frame[60:])
    wait_for(reader)
    reader.close()


def test_identify_says_whether_bytes_came(line) -> None:
    master, options = line
    reader = ImuReader(options)
    with pytest.raises(DeviceError, match="silent"):
        reader.identify(patience_s=0.05)
    os.write(master, b"\x55" * 100)
    with pytest.raises(DeviceError, match=r"bytes from .* baud rate"):
        reader.identify(patience_s=0.05)
    reader.close()


def test_a_port_that_cannot_be_opened_is_a_device_error() -> None:
    reader = ImuReader(ImuOptions("hipnuc", "no/such/port", 115200, 100.0))
    with pytest.raises(DeviceError, match="no/such/port"):
        reader.open()


def test_a_port_that_comes_back_is_opened_anew(tmp_path: Path) -> None:
    link = tmp_path / "imu"
    master, slave = os.openpty()
    link.symlink_to(os.ttyname(slave))
    reader = ImuReader(ImuOptions("hipnuc", str(link), 921600, 100.0))
    reader.open()
    os.write(master, hipnuc.encode(UPRIGHT))
    wait_for(reader)
    os.close(slave)
    os.close(master)
    assert reader.poll(time.monotonic()) is None
    assert not reader.is_open
    master, slave = os.openpty()
    link.unlink()
    link.symlink_to(os.ttyname(slave))
    assert reader.poll(time.monotonic()) is None  # too early to try again
    reader.poll(time.monotonic() + 10.0)
    assert reader.is_open
    os.write(master, hipnuc.encode(UPRIGHT))
    wait_for(reader)
    reader.close()
    os.close(master)
    os.close(slave)


def test_mounting_turns_a_sideways_imu_into_the_base() -> None:
    # The IMU's x axis points along the base's y: turned by 90 degrees about z. It lies level, turns about its own x.
    half = math.sqrt(0.5)
    mounting = Mounting((half, 0.0, 0.0, half))
    quat, gyro, acc = mounting.to_base(ImuSample((half, 0.0, 0.0, half), (1.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
    assert quat == pytest.approx([1, 0, 0, 0])  # the base itself points along the world's x
    assert gyro == pytest.approx([0, 1, 0])
    assert acc == pytest.approx([0, 0, 9.81])


def test_an_imu_upside_down_still_says_up() -> None:
    mounting = Mounting((0.0, 1.0, 0.0, 0.0))
    _, _, acc = mounting.to_base(ImuSample((0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -9.81)))
    assert acc == pytest.approx([0, 0, 9.81])


def test_mounting_and_its_inverse() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        mount, quat = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 4)))
        gyro, acc = rng.normal(size=(2, 3))
        mounting = Mounting(tuple(mount.tolist()))
        for back, value in zip(mounting.to_base(mounting.to_imu(quat, gyro, acc)), (quat, gyro, acc)):
            assert back == pytest.approx(value)


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("protocol", "xsens"),
        ("baud", 0),
        ("rate_hz", math.nan),
        ("poll_hz", -1.0),
        ("imu_to_base_wxyz", (1.0, 1.0, 0.0, 0.0)),
        ("imu_to_base_wxyz", (math.nan, 0.0, 0.0, 0.0)),
        ("rate_hz", 2000.0),
    ],
)
def test_what_cannot_be_is_refused(entry: str, value: object) -> None:
    fields = {"protocol": "hipnuc", "port": "p", "baud": 921600, "rate_hz": 500.0, entry: value}
    with pytest.raises(InputError):
        ImuOptions(**fields)
