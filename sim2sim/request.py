"""What an evaluation was asked to do."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from world.options import SimOptions, load_sim_options

EPISODES_PER_SEED = 1_000_000


@dataclass(frozen=True)
class EvaluationRequest:
    """One evaluation; picklable, so that every worker process builds the same thing from it.

    policies: names or files, all played under the same conditions. motions: clips, or sets of them, for actors that
    carry none; each actor plays each clip. goal: what an actor that follows goals is shown of them, see
    :data:`policy.goals.KINDS`. robot: a name or a file. friction, delay_s, push_m_s: None for what the
    simulation's file and `randomize` say. start: "reference" begins at the clip's first frame, "stand" on the ground.
    """

    policies: tuple[str, ...]
    motions: tuple[str, ...] = ()
    goal: str = "full"
    robot: str = "g1_23dof"
    sim: str = "default"
    sim_model: Path | None = None
    start: str = "reference"
    start_noise_rad: float = 0.0
    friction: float | None = None
    delay_s: float | None = None
    push_m_s: float | None = None
    episodes: int = 1
    randomize: bool = False
    seed: int = 0

    def sim_options(self) -> SimOptions:
        """The simulation's file with what was asked for on top. Raises InputError."""
        options = load_sim_options(self.sim)
        return replace(
            options,
            friction=options.friction if self.friction is None else self.friction,
            command_delay_s=options.command_delay_s if self.delay_s is None else self.delay_s,
            push_speed_m_s=options.push_speed_m_s if self.push_m_s is None else self.push_m_s,
            randomize=options.randomize or self.randomize,
        )

    def generator(self, episode: int) -> np.random.Generator:
        """All chance of one episode: the same for every policy, whichever process plays it.

        With seed 0 an episode's number is its generator's seed, the usual choice of evaluators; other seeds share none.
        """
        return np.random.default_rng(self.seed * EPISODES_PER_SEED + episode)

    def described(self) -> dict[str, str]:
        """The conditions in words."""
        return {
            "episodes": str(self.episodes),
            "robot": self.robot,
            "simulation": self.sim if self.sim_model is None else f"{self.sim}, model {self.sim_model}",
            "goal": self.goal,
            "start": f"{self.start}, joints + N(0, {self.start_noise_rad:g} rad)",
            "friction": "as the simulation says" if self.friction is None else f"{self.friction:g}",
            "delay": "as the simulation says" if self.delay_s is None else f"{1e3 * self.delay_s:g} ms",
            "push": "as the simulation says" if self.push_m_s is None else f"{self.push_m_s:g} m/s every 5 s",
            "randomized": "yes" if self.randomize else "no",
            "seed": str(self.seed),
        }
