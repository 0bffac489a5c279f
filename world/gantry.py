"""The gantry: four straps that hold the torso from a frame above, and let go gently."""

import itertools

import mujoco
import numpy as np

from robot.robot import Robot
from world.options import GantryOptions
from world.plant import Plant

RAMP_STEP_S = 0.01
STRAPS = tuple(f"gantry_{i}" for i in range(4))
NEVER = 2**62
UPRIGHT_WXYZ = np.array([1.0, 0.0, 0.0, 0.0])


def add_straps(spec: mujoco.MjSpec, robot: Robot, options: GantryOptions) -> None:
    """Add the straps as spatial tendons that only pull; `Gantry` sets their upper ends and lengths."""
    torso = spec.body(robot.randomized_com_body)
    half_m, height_m = options.attach_half_width_m, options.attach_height_m
    for strap, (x, y) in zip(STRAPS, itertools.product((1.0, -1.0), repeat=2)):
        torso.add_site(name=f"{strap}_torso", pos=[x * half_m, y * half_m, height_m], size=[0.01] * 3, group=4)
        spec.worldbody.add_site(name=f"{strap}_frame", pos=[x, y, 2.0], size=[0.01] * 3, group=4)
        tendon = spec.add_tendon(name=strap, width=0.005, rgba=[0.9, 0.6, 0.1, 1.0])
        tendon.wrap_site(f"{strap}_torso")
        tendon.wrap_site(f"{strap}_frame")


class Gantry:
    """The straps of one compiled model. An event of the simulation: `at` is the step of its next change."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, options: GantryOptions) -> None:
        self._model, self._data, self._options = model, data, options
        self._tendons = np.array([model.tendon(name).id for name in STRAPS])
        self._frame_sites = [model.site(f"{name}_frame").id for name in STRAPS]
        self._torso_sites = [model.site(f"{name}_torso").id for name in STRAPS]
        self._released_at = NEVER
        self._ramp_steps = max(1, round(options.release_s / model.opt.timestep))
        self._stride = max(1, round(RAMP_STEP_S / model.opt.timestep))
        self._pull(0.0)
        self.at = NEVER

    @property
    def attached(self) -> bool:
        """Whether the straps still pull."""
        return self._strength > 0

    def hang_at_present_pose(self) -> None:
        """Hang the straps so that they carry `support` of the weight in the pose that `data` is in."""
        model, data, options = self._model, self._data, self._options
        spread = np.array([options.frame_half_width_m, options.frame_half_width_m, 0.0])
        for torso_site, frame_site in zip(self._torso_sites, self._frame_sites):
            corner = np.sign(model.site_pos[torso_site])
            centre = data.site_xpos[self._torso_sites].mean(axis=0)
            model.site_pos[frame_site] = centre + corner * spread + [0.0, 0.0, options.frame_height_m]
        mujoco.mj_forward(model, data)
        reach = model.site_pos[self._frame_sites] - data.site_xpos[self._torso_sites]
        length_m = np.linalg.norm(reach, axis=1)
        weight_n = model.body_mass.sum() * -model.opt.gravity[2]
        tension_n = options.support * weight_n / (4 * reach[:, 2] / length_m)
        model.tendon_lengthspring[self._tendons, 0] = 0.0
        model.tendon_lengthspring[self._tendons, 1] = length_m - tension_n / options.stiffness_n_m
        self._pull(1.0)
        self._released_at = self.at = NEVER

    def release(self, step: int) -> None:
        """Begin to let go at a step."""
        if self.attached and self._released_at == NEVER:
            self._released_at = self.at = step

    def drop(self) -> None:
        """Let go at once."""
        self._pull(0.0)
        self._released_at = self.at = NEVER

    def act(self, step: int) -> None:
        """Fade further out."""
        strength = 1.0 - (step - self._released_at) / self._ramp_steps
        self._pull(max(0.0, strength))
        self.at = step + self._stride if strength > 0 else NEVER

    def _pull(self, strength: float) -> None:
        self._strength = strength
        self._model.tendon_stiffness[self._tendons] = strength * self._options.stiffness_n_m
        self._model.tendon_damping[self._tendons] = strength * self._options.damping_n_s_m
        self._model.tendon_rgba[self._tendons, 3] = strength


def hang_up(plant: Plant, gantry: Gantry, joint_pos_rad: np.ndarray, *, lift_m: float = 0.0) -> None:
    """At rest and slack in a joint pose (J,), feet on the ground or lifted by so much; the straps are set for the
    default pose, and stretch a little where they carry all of the weight."""
    pose = plant.robot.default_pos_rad
    height_m = plant.standing_height_m(pose) + lift_m
    plant.place(np.array([0.0, 0.0, height_m]), UPRIGHT_WXYZ, pose)
    gantry.hang_at_present_pose()
    height_m = max(height_m, plant.standing_height_m(joint_pos_rad))
    plant.place(np.array([0.0, 0.0, height_m]), UPRIGHT_WXYZ, joint_pos_rad)
