"""The driver of a Unitree G1 with 29 motors over DDS: LowState in, LowCmd out."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from core import robot_time as time
from hal.contract.types import DeviceError, DeviceFault, DeviceInfo, LinkLost
from hal.dds.battery import BatteryReader
from hal.dds.command import CommandFrames
from hal.dds.damper import DdsDamper
from hal.dds.link import DdsLink
from hal.dds.motion_service import MotionService
from hal.dds.observation import hand_refusal, least_hz, rate_refusal, refusals
from hal.dds.options import SIMULATOR, WAIVED, DdsOptions, load_dds_options
from hal.dds.slots import SlotMap
from hal.dds.state_reader import STATE_TOPIC, StateReader
from hal.dds.state_writer import StateWriter
from hal.dds.tick_clock import TickClock
from hal.dds.types import LowCmd_
from hal.wire.boards import StateBoard
from hal.wire.driver import Cycle, Damper, WireFactory
from hal.wire.lock import wire_name
from hal.wire.outbox import Kind, Outbox, Outgoing
from robot.robot import Robot
from world.actuation import damping_command

COMMAND_TOPIC = "rt/lowcmd"
LISTEN_S = 0.2
HEARER_S = 2.0
SECOND_CHECK_S = 0.05
DISABLING_FRAMES = 20
FEWEST_STATES = 10
PAUSE_S = 0.005
SECOND_CONTROLLER = "second controller: somebody else commands on rt/lowcmd"


class DdsDriver:
    """See hal.wire.driver.Driver.

    `enable` has the onboard motion service let go and makes sure that nobody else commands; only then LowCmd is sent,
    at `command_hz`, damping from the first one on. Damping frame: LowCmd with mode 1, kp = 0 and the robot's damping
    kd, the held joints likewise. `disable` sends mode 0. Raises InputError where the robot does not fit a G1's motors.
    """

    def __init__(self, robot: Robot, options: DdsOptions) -> None:
        self.joint_names = robot.joint_names
        self._options = options
        self._slots = SlotMap(robot, options.held)
        self._period_s = 1.0 / options.command_hz
        self._damping = Outgoing(Kind.DAMP, damping_command(robot.damping_kd))
        self._frames = CommandFrames(self._slots, options.held, options.held_speed_rad_s, self._period_s)
        self._states: StateReader | None = None
        self._battery: BatteryReader | None = None
        self._taken = False
        self._released: list[str] = []
        self._sent = 0
        self._next_check_s = -np.inf

    def identify(self) -> DeviceInfo:
        """See Driver."""
        options = self._options
        self._link = DdsLink(options.domain, options.interface)
        simulator = options.peer == SIMULATOR
        self._states = StateReader(self._link, simulator=simulator)
        self._battery = BatteryReader(self._link)
        self._others = self._link.reader(COMMAND_TOPIC, LowCmd_, others_only=True)
        self._service = MotionService(self._link) if options.motion_service == "release" else None
        rate_hz = self._await_states(self._states)
        observed = self._states.observed()
        self._clock = TickClock.fitted([int(message["tick"]) for message, _ in observed], [s for _, s in observed])
        messages = [message for message, _ in observed]
        reasons = refusals(messages, self._states.counts, options.held, options.mode_machine, simulator=simulator)
        reasons += [] if simulator else rate_refusal(rate_hz, options.state_hz)
        reasons += hand_refusal(self._link.published_topics())
        if reasons:
            raise DeviceFault(f"dds: refused, {self._link.name}: {'; '.join(reasons)}")
        active = "" if self._service is None else self._service.active_mode()
        if not active and self._others_command():
            raise DeviceFault(f"dds: refused, {self._link.name}: {SECOND_CONTROLLER}")
        message = self._message()
        details = {"peer": WAIVED} if simulator else {}
        details |= {
            "link": self._link.name,
            "mode_machine": str(message["mode_machine"]),
            "version": ".".join(str(part) for part in message["version"].tolist()),
            "motion service": f"{active!r} is active, let go before the first command" if active else "released",
            "states": f"{rate_hz:.0f} Hz",
            "commands": f"{options.command_hz:g} Hz",
            "ages": "by the robot's tick" if self._clock.usable else "by arrival, the robot's tick is no millisecond",
        }
        robot = f"G1, mode_machine {details['mode_machine']}, version {details['version']}"
        return DeviceInfo("Unitree G1", self.joint_names, details=details, identities={"robot": robot})

    def dampers(self) -> Sequence[Damper]:
        """See Driver."""
        options, machine = self._options, int(self._message()["mode_machine"])
        frames = CommandFrames(self._slots, options.held, options.held_speed_rad_s, self._period_s)
        bodies = frames.body(self._damping, machine, self._message()["motor_state"]), frames.disabled_body(machine)
        return [
            DdsDamper(
                "dds", self._period_s, options.domain, options.interface, COMMAND_TOPIC, self.joint_names, *bodies
            )
        ]

    def start(self, outbox: Outbox, state: StateBoard) -> Sequence[Cycle]:
        """See Driver."""
        self._outbox, self._board = outbox, state
        self._writer = StateWriter(state, self._slots, self._clock, int(self._message()["mode_machine"]))
        assert self._states is not None and self._battery is not None
        self._states.deliver(self._writer.hear)
        self._battery.deliver(state)
        return [Cycle("dds", self._period_s, self._run)]

    def enable(self) -> None:
        """See Driver. Where its motion service was active, the robot is limp until the first damping is heard."""
        self._taken = False
        if self._writer.lost is not None:
            raise DeviceFault(f"dds: {self._writer.lost}")
        if self._service is not None:
            self._released = self._service.release(self._options.release_s) or self._released
        if self._others_command():
            self._writer.latch(SECOND_CONTROLLER)
            raise DeviceFault(f"dds: {SECOND_CONTROLLER}")
        # Made here, so that a robot which is only looked at never sees a controller.
        self._commands = self._link.writer(COMMAND_TOPIC, LowCmd_)
        self._taken = True
        self._await_hearer()
        self._writer.commanding_since_s = time.monotonic()

    def acknowledge(self) -> None:
        """See Driver. Where taking over has failed it is done again, but never from a controller that came later."""
        self._writer.acknowledge()
        if not self._outbox.energised or self._writer.lost is not None:
            return
        if not self._taken:
            self.enable()
        elif not self._is_released():
            self._writer.lose("the motion service is active again")

    def disable(self) -> None:
        """See Driver."""
        if not self._taken:
            return
        body = self._frames.disabled_body(int(self._message()["mode_machine"]))
        for _ in range(DISABLING_FRAMES):
            self._commands.write(LowCmd_(body))
            time.sleep(PAUSE_S)

    def hand_back(self) -> str:
        """See HandsBack. The mode of the motion service that was released first is selected again."""
        if self._service is None or not self._released:
            return "not handed back: no motion service was active before"
        self._service.select(self._released[0], self._options.hand_back_s)
        return f"handed back: the motion service drives in mode {self._released[0]!r}"

    def close(self) -> None:
        """See Driver."""
        for reader in (self._states, self._battery):
            if reader is not None:
                reader.stop()
        for name in ("_commands", "_others", "_service", "_states", "_battery", "_link"):
            vars(self).pop(name, None)

    def _run(self, now_s: float) -> None:
        """One round: send what is to be sent, look out for others, pass on what ended the reader."""
        assert self._states is not None
        if self._writer.lost is not None:
            self._taken = False
            self._outbox.let_go()
        outgoing = self._outbox.at(time.monotonic())
        if self._taken:
            outgoing = self._damping if outgoing.kind is Kind.IDLE else outgoing
            message = self._message()
            body = self._frames.body(outgoing, int(message["mode_machine"]), message["motor_state"])
            self._commands.write(LowCmd_(body))
            self._sent += 1
        if now_s >= self._next_check_s:
            self._next_check_s = now_s + SECOND_CHECK_S
            self._look_around()
        if self._states.failure is not None:
            raise DeviceError(f"dds: reading {STATE_TOPIC}: {self._states.failure!r}") from self._states.failure

    def _look_around(self) -> None:
        if self._taken and self._others.take():
            self._writer.latch(SECOND_CONTROLLER)
        assert self._states is not None
        for name, count in vars(self._states.counts).items():
            self._board.stats(f"lowstate {name}", count)
        self._board.stats("lowcmd sent", self._sent)

    def _await_states(self, states: StateReader) -> float:
        """Observe the robot, until new states come as often as they should. How often at best, in Hz: this computer,
        when busy, may listen late."""
        options, rate_hz, since = self._options, 0.0, None
        simulated_hz = FEWEST_STATES / options.observe_s
        enough_hz = simulated_hz if options.peer == SIMULATOR else least_hz(options.state_hz)
        end_s = time.monotonic() + options.state_wait_s
        while rate_hz < enough_hz and (now_s := time.monotonic()) < end_s:
            if states.failure is not None:
                raise DeviceError(f"dds: reading {STATE_TOPIC}: {states.failure!r}") from states.failure
            heard = states.counts.heard - states.counts.repeated
            if heard and since is None:
                since, end_s = (now_s, heard), now_s + options.state_wait_s
            elif since is not None and now_s >= since[0] + options.observe_s:
                rate_hz = max(rate_hz, (heard - since[1]) / (now_s - since[0]))
                since = (now_s, heard)
            time.sleep(PAUSE_S)
        if states.counts.heard < FEWEST_STATES:
            within = f"{states.counts.heard or 'no'} LowState within {options.state_wait_s:g} s, {self._link.name}"
            raise LinkLost(f"dds: silent robot: {within}; is it on, and are interface and domain right?")
        return rate_hz

    def _is_released(self) -> bool:
        return self._service is None or not self._service.active_mode()

    def _await_hearer(self) -> None:
        """What is written before the robot has found the writer is lost. Raises DeviceError where it never does."""
        end_s = time.monotonic() + HEARER_S
        while not self._commands.get_matched_subscriptions():
            if time.monotonic() > end_s:
                self._taken = False
                raise DeviceError(f"dds: nobody hears {COMMAND_TOPIC} within {HEARER_S:g} s, {self._link.name}")
            time.sleep(PAUSE_S)

    def _others_command(self) -> bool:
        """Whether anybody else sends LowCmd now."""
        self._others.take()
        end_s = time.monotonic() + LISTEN_S
        while time.monotonic() < end_s:
            time.sleep(PAUSE_S)
            if self._others.take():
                return True
        return False

    def _message(self) -> np.ndarray:
        assert self._states is not None and self._states.latest is not None
        return self._states.latest[0]


def make_factory(config: Path, endpoints: Mapping[str, str]) -> WireFactory:
    """See hal.open.WIRES; endpoints may have `interface` and `domain`."""
    options = load_dds_options(config, endpoints)
    wire = wire_name("dds", options.interface, f"domain {options.domain}")
    return WireFactory(DdsDriver, options, (wire,), options.link_timeout_s)
