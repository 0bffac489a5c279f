"""`hal/emulate imu`, as docs/hal_imu.md says to start it."""

from dataclasses import replace

from core.config import config_file, load_options
from hal.emulator.launch import launch_emulator
from hal.imu.options import ImuOptions
from hal.imu.reader import ImuReader


def test_the_imu_alone_can_be_started_reset_and_read() -> None:
    with launch_emulator("imu", "imu_hipnuc") as emulator:
        emulator.control.reset()
        options = load_options(ImuOptions, config_file("hal", "imu_hipnuc"))
        reader = ImuReader(replace(options, port=emulator.endpoints["imu"], rate_hz=100.0))
        try:
            assert "hipnuc" in reader.identify(10.0)
        finally:
            reader.close()
