"""Where imagination begins: in states that simulated robots were in lately, and in noisy reference frames."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from core.rotations import quat_from_rotvec, quat_mul
from train.mdp.draws import normal, one_of, rand, whole
from train.mdp.failures import BIN_TICKS
from train.mdp.gait import tick_in_step, told_speeds_alone
from train.mdp.goals import Goals
from train.mdp.tick import ReferenceTable
from train.mdp.tracking import CONTROL_PERIOD_S
from train.world_model.ring import Ring
from train.world_model.settings import StartsSettings
from train.world_model.state import Motion, reference_motion, unpack

# Standard deviations of what is added to a reference frame: m, rad, m/s, rad/s, rad, rad/s.
PLACE_NOISE_M = (0.05, 0.05, 0.005)
NOISE = {"tilt": 0.05, "lin_vel": 0.15, "ang_vel": 0.3, "joint_pos": 0.04, "joint_vel": 0.5}


@dataclass(frozen=True)
class Start:
    """Of N robots.

    Attributes:
        motion: their states.
        past: (L, N, ·) their states of the last L ticks before, newest first; what an episode lacks repeats its first.
        past_targets: (L + 1, N, J) the targets of those ticks and of the one before them, newest first.
        age: (N,) steps since their episodes began, which tells how much of the past there is.
        clip, tick: (N,) what they track, and where in it they are.
        goal: (N,) bits of what of it they are shown.
        context: (N, C + 6) packed.
    """

    motion: Motion
    past: Motion
    past_targets: Tensor
    age: Tensor
    clip: Tensor
    tick: Tensor
    goal: Tensor
    context: Tensor


class Starts:
    """Draws starts.

    Args:
        settings: shares and noise.
        ring: what simulated robots did.
        table: the references.
        past: L.
        generator: source of randomness.
        goals: draws what robots are shown.
    """

    def __init__(
        self,
        settings: StartsSettings,
        ring: Ring,
        table: ReferenceTable,
        past: int,
        generator: torch.Generator,
        goals: Goals,
    ) -> None:
        self._settings, self._ring, self._table, self._past = settings, ring, table, past
        self.generator, self._goals = generator, goals
        self._reach = round(goals.settings.phase_s / CONTROL_PERIOD_S)

    def draw(self, number: int, hard: Tensor) -> Start:
        """``number`` starts; ``hard`` (C, bins): the weights by which frames of clips are drawn where robots fail."""
        newest = self._settings.newest_steps // self._ring.num_envs
        times, robots = self._ring.sample(number, 0, newest, self.generator)
        start = self.in_step(self.of(times[0], robots))
        return self.anchored(self._with_references(start, round(self._settings.reference_share * number), hard))

    def of(self, times: Tensor, robots: Tensor) -> Start:
        """What robots (n,) were in at places in time (n,)."""
        ring = self._ring
        now = ring.at(times, robots)
        lags = torch.arange(1, self._past + 2, device=times.device)[:, None]
        known = (times - torch.minimum(now.age, lags[:-1])) % ring.steps
        return Start(
            unpack(torch.nan_to_num(now.state)),
            unpack(torch.nan_to_num(ring.states(known, robots))),
            ring.targets((times - lags) % ring.steps, robots),
            now.age,
            now.clip,
            now.tick,
            now.goal,
            now.context,
        )

    def _with_references(self, start: Start, number: int, hard: Tensor) -> Start:
        """The first ``number`` begin episodes in noisy reference frames instead, half of them where robots fail."""
        clip, tick = self._frames(number, hard)
        rows = self._table.rows(clip, tick)
        frames = self._noisy(reference_motion(rows), rows.lift_m)

        def changed(values: Tensor, new: Tensor) -> Tensor:
            return torch.cat([new, values[number:]])

        return replace(
            start,
            motion=Motion(*map(changed, start.motion, frames)),
            age=changed(start.age, torch.zeros_like(tick)),
            clip=changed(start.clip, clip),
            tick=changed(start.tick, tick),
            goal=changed(start.goal, self._goals.draw(clip)),
        )

    def _frames(self, number: int, hard: Tensor) -> tuple[Tensor, Tensor]:
        """Clips and ticks (n,): half by ``hard``, half from anywhere in the set."""
        g, num_ticks = self.generator, self._table.num_ticks
        failing = number // 2
        chosen = one_of(hard.flatten(), failing, g)
        inside = whole(0, BIN_TICKS, failing, g, hard.device)
        clip, tick = chosen // hard.shape[1], (chosen % hard.shape[1]) * BIN_TICKS + inside
        anywhere = one_of(num_ticks.float(), number - failing, g)
        at = (rand((number - failing,), g, hard.device) * num_ticks[anywhere]).long()
        clip, tick = torch.cat([clip, anywhere]), torch.cat([tick, at])
        return clip, torch.minimum(tick, num_ticks[clip] - 1)

    def _noisy(self, frames: Motion, lift_m: Tensor) -> Motion:
        def off(values: Tensor, std: float) -> Tensor:
            return values + normal(values.shape, std, self.generator, values.device)

        device = frames.pos_w.device
        spread_m = torch.tensor(PLACE_NOISE_M, device=device)
        place = normal(frames.pos_w.shape, 1.0, self.generator, device) * spread_m
        place[:, 2] += lift_m
        tilt = quat_from_rotvec(normal(frames.pos_w.shape, NOISE["tilt"], self.generator, device))
        return Motion(
            frames.pos_w + place,
            quat_mul(frames.quat_wxyz, tilt),
            off(frames.lin_vel_b, NOISE["lin_vel"]),
            off(frames.ang_vel_b, NOISE["ang_vel"]),
            off(frames.joint_pos_rad, NOISE["joint_pos"]),
            off(frames.joint_vel_rad_s, NOISE["joint_vel"]),
        )

    def in_step(self, start: Start) -> Start:
        """With the references of robots that are told of speeds alone moved in time to where their gait is."""
        (free,) = told_speeds_alone(start.goal).nonzero(as_tuple=True)
        if not self._reach or not len(free):
            return start
        joints = start.motion.joint_pos_rad[free], start.motion.joint_vel_rad_s[free]
        moved = start.tick.clone()
        moved[free] = tick_in_step(self._table, start.clip[free], start.tick[free], *joints, self._reach)
        return replace(start, tick=moved)

    def anchored(self, start: Start) -> Start:
        """Moved along the ground to within ``place_m`` of the reference: a robot can know nothing of its place."""
        there = self._table.rows(start.clip, start.tick).root_pos_w[:, :2]
        off = start.motion.pos_w[:, :2] - there
        most = self._settings.place_m
        near = there + off * (most / off.norm(dim=1, keepdim=True).clamp(min=most))
        pos = torch.cat([near, start.motion.pos_w[:, 2:]], dim=1)
        return replace(start, motion=start.motion._replace(pos_w=pos))
