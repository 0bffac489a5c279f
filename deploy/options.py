"""What a run was asked to do."""

from dataclasses import dataclass
from pathlib import Path

from deploy.episode import Start
from deploy.outputs import check_output_file, check_output_folder
from robot.errors import InputError


@dataclass(frozen=True)
class RunOptions:
    """The options of deploy/run. realtime: None chooses: yes with a person (keyboard or viewer), no otherwise."""

    backend: str
    policies: tuple[str, ...]
    motion: str | None = None
    stand: str = "stand"
    robot: str = "g1_23dof"
    settings: str = "default"
    interactive: bool = False
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
    dry_run: bool = False
    json: Path | None = None
    seed: int = 0

    @property
    def on_wall_clock(self) -> bool:
        """Whether the run keeps pace with the wall clock."""
        return self.interactive or self.viewer if self.realtime is None else self.realtime

    def check(self) -> None:
        """Raise InputError on combinations and output paths that cannot work, before anything is loaded."""
        check_output_file("--json", self.json)
        check_output_file("--video", self.video)
        check_output_folder("--log", self.log)
        if len(self.policies) > 1 and not self.interactive:
            raise InputError("several --policy", hint="add --interactive: a person chooses between them")
        if self.interactive and self.realtime is False:
            raise InputError("--interactive and --fast", hint="a person needs --realtime")
        if self.backend != "mujoco" and (self.viewer or self.sim_model or self.sim != "default"):
            raise InputError("--sim, --sim-model and --viewer", got=f"--backend {self.backend}", expected="mujoco")
        if self.meshes and self.viewer and self.sim_model:
            raise InputError("--meshes with --viewer and --sim-model", hint="the window shows the model file as it is")
        if self.start is Start.STAND and self.start_noise_rad and self.backend != "mujoco":
            raise InputError("--start-noise", got=f"--backend {self.backend}", expected="mujoco, or --start reference")
