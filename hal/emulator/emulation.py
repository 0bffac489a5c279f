"""One emulator in one process: robot, faults, device side and control socket together."""

import threading
from collections.abc import Mapping, Sequence
from typing import Any, Self

from core import robot_time
from core.errors import InputError
from hal.emulator.control import ControlServer
from hal.emulator.device import device_class, fault_kinds
from hal.emulator.faults import EVERYTHING, EmulatedFault, Faults
from hal.emulator.robot import EmulatedRobot
from robot.robot import Robot
from world.scene import FLAT, Scene


class Emulation:
    """A running emulator of one kind. Entering starts it, leaving ends it.

    config: what the device side reads, a name in configs/hal or a file; None: its default. scene: what the robot
    stands in. faults: the script. Raises InputError before anything is opened.
    """

    def __init__(
        self,
        kind: str,
        config: str | None,
        robot: Robot,
        *,
        scene: Scene = FLAT,
        faults: Sequence[EmulatedFault] = (),
        start_noise_rad: float = 0.0,
        seed: int = 0,
    ) -> None:
        device = device_class(kind)
        self.kind = kind
        self.faults = Faults(faults, kinds=fault_kinds(device), seed=seed)
        self.robot = EmulatedRobot(robot, self.faults, scene=scene, start_noise_rad=start_noise_rad, seed=seed)
        self.device = device(self.robot, self.faults, config or device.default_config)
        self.faults.begin(self.device.fault_keys)
        self.control = ControlServer(self.answer)
        self.asked_to_quit = threading.Event()

    @property
    def failure(self) -> Exception | None:
        """What broke the robot or its devices, if anything did."""
        return self.robot.failure or self.device.failure

    def __enter__(self) -> Self:
        """Let time run, open the wire, answer requests."""
        self.robot.start()
        try:
            self.device.start()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        self.control.start()
        self.faults.begin(self.device.fault_keys)
        return self

    def __exit__(self, *_: object) -> None:
        """Close the wire and stop."""
        self.control.stop()
        self.device.stop()
        self.robot.stop()

    def ready(self) -> dict[str, Any]:
        """What whoever started the emulator must know, as plain data."""
        return {"emulator": self.kind, "control": self.control.address, "endpoints": dict(self.device.endpoints)}

    def answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """One request to the control socket. Raises InputError on one that makes no sense."""
        do = request["do"]
        content = {key: value for key, value in request.items() if key != "do" and value is not None}
        match do:
            case "release_gantry":
                self.robot.release_gantry()
            case "gantry":
                return {"attached": self.robot.gantry_attached}
            case "lean":
                self.robot.lean(float(content.get("forwards_rad", 0.0)), float(content.get("left_rad", 0.0)))
            case "reset":
                numbers = {name: float(content.get(name, 0.0)) for name in ("start_noise_rad", "lift_m")}
                self.robot.reset(seed=int(content.get("seed", 0)), **numbers)
                self.device.reset()
            case "fault":
                name, key = str(content.pop("kind", "")), str(content.pop("key", EVERYTHING))
                self.faults.add(name, key, **{what: float(value) for what, value in content.items()})
            case "clear_fault":
                return {"cleared": self.faults.clear(content.get("kind"), content.get("key"))}
            case "status":
                return self.status()
            case "device":
                return self.device.request(content)
            case "follow":
                pace = robot_time.Pace(**content)
                threading.Thread(target=robot_time.follow, args=(pace,), name="pace", daemon=True).start()
            case "quit":
                self.asked_to_quit.set()
            case _:
                raise InputError("unknown request", where="emulator", got=do)
        return {}

    def status(self) -> dict[str, Any]:
        """Everything, as plain data."""
        device, faults = self.device.status(), self.faults.listing()
        return {"kind": self.kind, **self.robot.status(), "faults": faults, "device": device}
