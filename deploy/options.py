"""What a run was asked to do."""

from dataclasses import dataclass
from pathlib import Path

from core.errors import InputError
from core.files import check_output_file, check_output_folder
from deploy.episode import Start
from deploy.goals.option import GoalOption, parse_goal
from hal.open import WIRES


@dataclass(frozen=True)
class RunOptions:
    """The options of deploy/run. realtime: None chooses: yes with a person or a wire, no otherwise."""

    backend: str
    policies: tuple[str, ...]
    motions: tuple[str, ...] = ()
    goal: str | None = None
    stand: str = "stand"
    robot: str = "g1_23dof"
    settings: str = "default"
    interactive: bool = False
    hal_config: str | None = None
    emulate: bool = False
    faults: tuple[str, ...] = ()
    interface: str | None = None
    domain: int | None = None
    peer: str = "robot"
    hand_back: bool = False
    gamepad: Path | None = None
    first_run_ok: bool = False
    sim: str = "default"
    sim_model: Path | None = None
    start: Start = Start.STAND
    start_noise_rad: float = 0.0
    duration_s: float | None = None
    realtime: bool | None = None
    video: Path | None = None
    viewer: bool = False
    meshes: Path | None = None
    log: Path | None = None
    status_port: int | None = None
    dry_run: bool = False
    json: Path | None = None
    seed: int = 0

    @property
    def on_wire(self) -> bool:
        """Whether the backend is a wire, emulated or not."""
        return self.backend in WIRES

    @property
    def on_real_wire(self) -> bool:
        """Whether a real robot may be at the other end."""
        return self.on_wire and not self.emulate

    @property
    def attended(self) -> bool:
        """Whether a person asks for every step. On a real wire always."""
        return self.interactive or self.on_real_wire

    @property
    def on_wall_clock(self) -> bool:
        """Whether the run keeps pace with the wall clock."""
        return self.on_wire or (self.interactive or self.viewer if self.realtime is None else self.realtime)

    @property
    def endpoints(self) -> dict[str, str]:
        """Where a wire connects instead of what its configuration says."""
        given = {"interface": self.interface, "domain": None if self.domain is None else str(self.domain)}
        given["peer"] = None if self.peer == "robot" else self.peer
        return {name: value for name, value in given.items() if value is not None}

    def check(self) -> None:
        """Raise InputError on combinations and output paths that cannot work, before anything is loaded."""
        check_output_file("--json", self.json)
        check_output_file("--video", self.video)
        check_output_folder("--log", self.log)
        if self.interactive and self.realtime is False:
            raise InputError("--interactive and --fast", hint="a person needs --realtime")
        if self.backend != "mujoco" and (self.viewer or self.sim_model or self.sim != "default"):
            raise InputError("--sim, --sim-model and --viewer", got=f"--backend {self.backend}", expected="mujoco")
        if self.meshes and self.viewer and self.sim_model:
            raise InputError("--meshes with --viewer and --sim-model", hint="the window shows the model file as it is")
        simulated = self.backend == "mujoco" or self.emulate
        if self.start is Start.STAND and self.start_noise_rad and not simulated:
            expected = "mujoco, --emulate, or --start reference"
            raise InputError("--start-noise", got=f"--backend {self.backend}", expected=expected)
        self._check_wire()
        if self.goal is not None:
            self._check_goal(parse_goal(self.goal))

    def _check_goal(self, goal: GoalOption) -> None:
        if self.motions:
            raise InputError("--goal and --motion", hint="--motion FILE means --goal clip:FILE:full")
        if len(self.policies) > 1:
            raise InputError("--goal with several --policy", got=", ".join(self.policies), expected="one")
        if goal.steered and self.start is Start.REFERENCE:
            raise InputError("--start reference", got=f"--goal {self.goal}", expected="a clip, as it has a first frame")
        if goal.source == "stick" and not self.attended:
            raise InputError("--goal stick", hint="add --interactive: a person steers")

    def _check_wire(self) -> None:
        wires, got = ", ".join(WIRES), f"--backend {self.backend}"
        if self.hand_back and self.backend != "dds":
            raise InputError("--hand-back", got=got, expected="dds", hint="no other robot has a controller of its own")
        if self.peer != "robot" and (self.backend != "dds" or self.emulate):
            raise InputError("--peer", got=got, expected="dds, without --emulate")
        if (self.emulate or self.first_run_ok) and not self.on_wire:
            raise InputError("--emulate and --first-run-ok", got=got, expected=f"one of {wires}")
        if self.faults and not self.emulate:
            raise InputError("--fault", hint="it strikes the emulator: add --emulate")
        if self.endpoints and (self.backend != "dds" or self.emulate):
            emulated = " with --emulate" if self.emulate else ""
            raise InputError("--interface and --domain", got=got + emulated, expected="dds and a real robot")
        if self.hal_config and self.backend == "mujoco":
            raise InputError("--hal-config", got=got, expected=f"one of mock, {wires}")
        if self.on_wire and self.realtime is False:
            raise InputError("--fast", got=got, hint="a wire has its own pace")
        if self.on_wire and self.start is Start.REFERENCE:
            raise InputError("--start reference", got=got, expected="mock or mujoco", hint="a real robot stands up")
        if self.gamepad is not None and not self.attended:
            raise InputError("--gamepad", hint="add --interactive")
