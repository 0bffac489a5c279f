"""configs/hal/dds.yaml."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from core.config import load_options
from core.errors import InputError
from core.structured import at_least, one_of, positive, within
from hal.dds.link import LOOPBACK
from hal.dds.slots import FULL_MACHINES, HeldMotor

SERVICES = ("release", "none")
HANDS = ("rubber",)
ROBOT, SIMULATOR = "robot", "simulator"
WAIVED = "peer simulator: checksum, mode_machine, tick and rate are not checked"


@dataclass(frozen=True)
class EmulatorOptions:
    """How the emulated robot differs from one to the next."""

    state_hz: float
    mode_machine: int
    motion_service: str
    release_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        at_least("release_s", self.release_s, 0)
        within("state_hz", self.state_hz, 1, 2000)
        within("mode_machine", self.mode_machine, 0, 255)


@dataclass(frozen=True)
class DdsOptions:
    """configs/hal/dds.yaml. peer: who is at the other end; said on the command line alone, and `simulator` on loopback
    alone: the maker's Python simulator leaves checksum, mode_machine and tick at 0, sends at a rate of its own and has
    no motion service.
    """

    interface: str
    domain: int
    command_hz: float
    state_hz: float
    link_timeout_s: float
    state_wait_s: float
    observe_s: float
    motion_service: str
    release_s: float
    mode_machine: int
    hands: str
    hand_back_s: float
    held_speed_rad_s: float
    held: tuple[HeldMotor, ...]
    emulator: EmulatorOptions
    peer: str = ROBOT

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        for name in ("link_timeout_s", "state_wait_s", "observe_s", "release_s", "hand_back_s", "held_speed_rad_s"):
            positive(name, getattr(self, name))
        within("command_hz", self.command_hz, 50, 1000)
        within("state_hz", self.state_hz, 50, 2000)
        within("domain", self.domain, 0, 232)
        one_of("motion_service", self.motion_service, SERVICES)
        one_of("mode_machine", self.mode_machine, sorted(FULL_MACHINES), "no G1 with 29 free motors")
        one_of("hands", self.hands, HANDS, "hands that the robot's model does not have, at the end of its arms")
        one_of("peer", self.peer, (ROBOT, SIMULATOR))
        if self.peer == SIMULATOR and self.interface != LOOPBACK:
            raise InputError("--peer simulator", got=f"interface {self.interface!r}", expected=f"interface {LOOPBACK}")


def load_dds_options(config: Path, endpoints: Mapping[str, str]) -> DdsOptions:
    """A configuration file, with `interface` and `domain` of endpoints instead of its own, and their `peer`.

    Raises InputError on an unusable entry, or where no interface is named.
    """
    options = load_options(DdsOptions, config)
    if options.peer != ROBOT:
        raise InputError("peer", where=config, got=options.peer, hint="say --peer simulator on the command line")
    domain = endpoints.get("domain", str(options.domain))
    if not domain.isdecimal():
        raise InputError("domain", where="dds", got=domain, expected="a whole number from 0 to 232")
    options = replace(options, interface=endpoints.get("interface", options.interface), domain=int(domain))
    if not options.interface:
        hint = "name it with --interface (`ip -brief address` lists them; the G1's network is 192.168.123.0/24)"
        raise InputError("no network interface", where=config, hint=hint)
    if endpoints.get("peer", ROBOT) == ROBOT:
        return options
    return replace(options, peer=endpoints["peer"], motion_service="none")
