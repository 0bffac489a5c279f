"""A device without a wire, for what is common to all emulators, and a clock that tests move."""

from types import MappingProxyType

from core.errors import InputError
from hal.emulator.device import DeviceSide
from hal.emulator.faults import FaultKind
from robot.robot import load_robot

G1 = load_robot()


class FakeTime:
    def __init__(self, now_s=100.0):
        self.now_s = now_s

    def __call__(self):
        return self.now_s


class WirelessDevice(DeviceSide):
    default_config = "nothing"
    fault_kinds = MappingProxyType({"sneeze": FaultKind("says so", 1.0)})

    def __init__(self, robot, faults, config):
        if config == "bad":
            raise InputError("bad configuration", got=config)
        self.robot, self.faults, self.config = robot, faults, config
        self.calls = []
        self.broken = None

    @property
    def endpoints(self):
        return {"bus0": f"{self.config}://here"}

    @property
    def fault_keys(self):
        return (*self.robot.joint_names, "bus0")

    @property
    def failure(self):
        return self.broken

    def start(self):
        self.calls.append("start")

    def stop(self):
        self.calls.append("stop")

    def reset(self):
        self.calls.append("reset")

    def status(self):
        return {"calls": list(self.calls)}
