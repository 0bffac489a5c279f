"""Rollouts of the policy in the world model, through which gradients pass to the policy."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from core.rotations import projected_gravity
from policy.observation import sample_terms, window_ticks
from policy.reference import ReferenceWindow
from policy.spec import ObservationGroup
from policy.terms import ObservationInput
from robot.robot import Robot
from train.mdp.draws import normal
from train.mdp.goals import shows, visible
from train.mdp.sensing import Senses
from train.mdp.tick import ReferenceRows, ReferenceTable
from train.world_model.context import Context, context_of
from train.world_model.cost import Imagined
from train.world_model.history import History
from train.world_model.model import WorldModel
from train.world_model.policy import BoundedResidual, Layout, carrying_targets
from train.world_model.settings import ImaginationSettings
from train.world_model.starts import Start
from train.world_model.state import Motion, reference_motion
from world.options import SensorNoise


@dataclass(frozen=True)
class Rollout:
    """H steps of B robots.

    Attributes:
        imagined: what the steps cost by.
        alive: (H, B) 1 until a robot is lost, from then on 0.
        wish: (H, B, J) what the network asked for.
        ahead: (H + 1, B, A) what the policy saw of the reference alone, and would see next.
        context: of the robots.
    """

    imagined: Imagined
    alive: Tensor
    wish: Tensor
    ahead: Tensor
    context: Context


class Imagination:
    """Plays the policy in the world model, with what a robot would measure.

    Args:
        robot: the robot.
        group: the actor's observation.
        table: the references.
        noise: of the sensors.
        settings: horizon, noise on actions, when a robot is lost.
        action_scale: rad of a raw action of 1.
        control_period_s: of a step.
        generator: source of the noise.
    """

    def __init__(
        self,
        robot: Robot,
        group: ObservationGroup,
        table: ReferenceTable,
        noise: SensorNoise,
        settings: ImaginationSettings,
        action_scale: float,
        control_period_s: float,
        generator: torch.Generator,
    ) -> None:
        self._robot, self._table, self._settings, self.generator = robot, table, settings, generator
        self._noise = noise
        layout = Layout(group, robot.num_joints)
        self._measured, self._compared, self._ahead = layout.terms, layout.compared, layout.ahead
        self._lags, self._blocks = layout.lags, layout.blocks
        self._base = [slice(part.start - layout.state_size, part.stop - layout.state_size) for part in layout.base]
        self._ticks = {terms: window_ticks([ObservationGroup("of", terms)]) for terms in (self._compared, self._ahead)}
        self._device = device = table.num_ticks.device
        self._default = torch.tensor(robot.default_pos_rad, device=device).float()
        self._action_scale, self._joints, self.horizon = action_scale, robot.num_joints, settings.horizon
        self._control_period_s = control_period_s
        self._feet = robot.tracked_index(robot.feet).tolist()
        self._kp_share, self._kd_share = (
            torch.tensor(gain / robot.torque_limit_nm, device=device).float() for gain in (robot.kp, robot.kd)
        )

    def play(self, policy: BoundedResidual, model: WorldModel, start: Start, *, noisy: bool) -> Rollout:
        """Both networks are prepared. ``noisy``: whether half of the robots act with noise."""
        steps, on = self.horizon, self._device
        clip, tick = start.clip.repeat(steps + 1, 1), start.tick + torch.arange(steps + 1, device=on)[:, None]
        ahead = self._look_ahead(clip, tick, start.goal)
        encoded_ahead = policy.network.encode(ahead[:-1].flatten(0, 1)).unflatten(0, ahead[:-1].shape[:2]).unbind(0)
        carrying = (carrying_targets(*(ahead[..., part] for part in self._base)) / self._action_scale).unbind(0)
        compared_with = self._windows(clip, tick, start.goal, self._ticks[self._compared])
        noise = self._action_noise(len(start.clip)) if noisy else [torch.zeros((), device=on)] * steps
        context = context_of(start.context, self._joints)
        encoded, offset = model.encode(context), context.sensing.encoder_offset_rad
        motion, earlier, last_action = start.motion, _before(start), self._actions(start, context)[0]
        history, gravity_b = self._past(start, context)
        before: tuple[Tensor, Tensor] | None = None
        befores, states, wishes, targets = [], [], [], []
        for k in range(steps):
            senses = self._sense(motion, earlier, context, start.age + k)
            gravity_b = senses.filtered(gravity_b, self._filtered(start) + k, self._control_period_s)
            seen = self._seen(senses, gravity_b, last_action, compared_with[k])
            state = torch.cat(
                [*history.push(sample_terms(self._measured, seen)), sample_terms(self._compared, seen)], 1
            )
            wish = policy.wish(state, encoded_ahead[k])
            last_action = carrying[k] + policy.added(wish) + noise[k]
            target = self._default + self._action_scale * last_action - offset
            before = before or self._queue(start, target)
            befores.append(motion)
            earlier = motion
            motion = model.step(motion, projected_gravity(motion.quat_wxyz), (target, *before), context, encoded)
            before = target, before[0]
            states.append(motion)
            wishes.append(wish)
            targets.append(target)
        rows = self._table.rows(clip[1:].flatten(), tick[1:].flatten())
        imagined = self.compare(states, befores, torch.stack(targets), torch.stack(wishes), rows, start.goal)
        return Rollout(imagined, self._alive(imagined), torch.stack(wishes), ahead, context)

    def first_sight(self, start: Start) -> tuple[Tensor, Tensor, Motion, Motion, Context]:
        """What policies and critics see at the start: (N, S) of the robot, (N, A) ahead; state, reference, context."""
        clip, tick = start.clip[None], start.tick[None]
        ahead = self._look_ahead(clip, tick, start.goal)[0]
        window = self._windows(clip, tick, start.goal, self._ticks[self._compared])[0]
        context = context_of(start.context, self._joints)
        last_action = self._actions(start, context)[0]
        history, gravity_b = self._past(start, context)
        senses = self._sense(start.motion, _before(start), context, start.age)
        gravity_b = senses.filtered(gravity_b, self._filtered(start), self._control_period_s)
        seen = self._seen(senses, gravity_b, last_action, window)
        state = torch.cat([*history.push(sample_terms(self._measured, seen)), sample_terms(self._compared, seen)], 1)
        reference = reference_motion(self._table.rows(start.clip, start.tick))
        return state, ahead, start.motion, reference, context

    def _look_ahead(self, clip: Tensor, tick: Tensor, goal: Tensor) -> Tensor:
        """The terms of the reference alone (H + 1, B, A)."""
        window = self._window(clip, tick, goal, self._ticks[self._ahead])
        return sample_terms(self._ahead, self._seen(None, None, None, window)).unflatten(0, clip.shape)

    def _window(self, clip: Tensor, tick: Tensor, goal: Tensor, ticks: tuple[int, ...]) -> ReferenceWindow:
        """Of all H + 1 moments of B robots, one after the other; the goal (B,) stays as it is."""
        window = self._table.window(clip.flatten(), tick.flatten(), ticks)
        return replace(window, visible=visible(goal).repeat(len(clip), 1))

    def _windows(self, clip: Tensor, tick: Tensor, goal: Tensor, ticks: tuple[int, ...]) -> list[ReferenceWindow]:
        """One for each of the H + 1 moments."""
        present = {k: v for k, v in vars(self._window(clip, tick, goal, ticks)).items() if isinstance(v, Tensor)}
        parts = [part.unflatten(0, clip.shape).unbind(0) for part in present.values()]
        return [ReferenceWindow(ticks, **dict(zip(present, moment))) for moment in zip(*parts, strict=True)]

    def _sense(self, motion: Motion, before: Motion, context: Context, age: Tensor) -> Senses:
        """What the robots' sensors make of a state, ``age`` (..., N) steps into the episode."""
        now, earlier = (
            Senses(m.quat_wxyz, m.ang_vel_b, m.joint_pos_rad, m.joint_vel_rad_s) for m in (motion, before)
        )  # fmt: skip
        seen = context.sensing.sense(now, earlier, self._control_period_s * age)
        return seen.noisy(self._noise, 1.0, self.generator)

    def _filtered(self, start: Start) -> Tensor:
        """(N,) past ticks that the filters have seen at the start: not what is older than the start knows of."""
        return start.age.clamp(max=len(start.past.pos_w) - 1)

    def _seen(
        self,
        senses: Senses | None,
        gravity_b: Tensor | None,
        last_action: Tensor | None,
        window: ReferenceWindow | None,
    ) -> ObservationInput:
        """What terms look at."""
        return ObservationInput(
            base_quat_wxyz=senses and senses.root_quat_wxyz,
            base_ang_vel_b=senses and senses.root_ang_vel_b,
            joint_pos_rad=senses and senses.joint_pos_rad,
            joint_vel_rad_s=senses and senses.joint_vel_rad_s,
            last_action=last_action,
            phase=None,
            default_pos_rad=self._default,
            filtered_gravity_b=gravity_b,
            reference=window,
        )

    def _actions(self, start: Start, context: Context) -> Tensor:
        """(L + 1, N, J) raw actions before the present moment and before each of the past ones; zero where was none."""
        raw = (start.past_targets + context.sensing.encoder_offset_rad - self._default) / self._action_scale
        return torch.where(self._known(start, len(raw)), raw, 0.0)

    def _known(self, start: Start, number: int) -> Tensor:
        """(number, N, 1) whether the episode had begun by each past moment, newest first."""
        return (start.age > torch.arange(number, device=self._device)[:, None])[..., None]

    def _past(self, start: Start, context: Context) -> tuple[History, Tensor]:
        """What was measured at past moments, zero where there was none; what filters made of it last (N, 3)."""
        motion, before = (Motion(*(part[rows] for part in start.past)) for rows in (slice(-1), slice(1, None)))
        number = len(motion.pos_w)
        ages = start.age - 1 - torch.arange(number, device=self._device)[:, None]
        senses = self._sense(motion, before, context, ages)
        gravity_b = [torch.zeros_like(start.motion.ang_vel_b)]
        for back in reversed(range(number)):
            then = Senses(*(part[back] for part in senses.tensors().values()))
            ticks = (self._filtered(start) - 1 - back).clamp(min=0)
            gravity_b.append(then.filtered(gravity_b[-1], ticks, self._control_period_s))
        actions = self._actions(start, context)[1 : number + 1]
        seen = self._seen(senses, torch.stack(gravity_b[:0:-1]), actions, None)
        measured = torch.where(self._known(start, number), sample_terms(self._measured, seen), 0.0)
        return History(measured.unbind(0), self._lags, self._blocks), gravity_b[-1]

    def _queue(self, start: Start, first: Tensor) -> tuple[Tensor, Tensor]:
        """The two targets before the ``first``, with which a new episode's queue is filled."""
        one = torch.where(start.age[:, None] >= 1, start.past_targets[0], first)
        return one, torch.where(start.age[:, None] >= 2, start.past_targets[1], one)

    def _action_noise(self, robots: int) -> list[Tensor]:
        """(N, J) for each step, on raw actions of every other robot, low-passed."""
        s, g = self._settings, self.generator
        every_other = (torch.arange(robots, device=self._device) % 2)[:, None].float() / self._action_scale
        fresh = normal((s.horizon, robots, self._joints), s.noise_rad, g, self._device) * every_other
        noise, now = [], torch.zeros(robots, self._joints, device=self._device)
        for step in fresh:
            now = s.noise_memory * now + (1.0 - s.noise_memory**2) ** 0.5 * step
            noise.append(now)
        return noise

    def compare(
        self,
        states: list[Motion],
        befores: list[Motion],
        targets: Tensor,
        wishes: Tensor,
        rows: ReferenceRows,
        goal: Tensor,
    ) -> Imagined:
        """What H steps cost by.

        States after and before each, targets and wishes (H, B, J), references after each, goals (B,).
        """
        motion = Motion(*(torch.stack(parts) for parts in zip(*states, strict=True)))
        q, speed = (torch.stack(parts) for parts in list(zip(*befores, strict=True))[-2:])
        shape = wishes.shape[:2]
        odd = [part[1::2].flatten(0, 1) for part in (motion.pos_w, motion.quat_wxyz, motion.joint_pos_rad)]
        points = self._robot.kinematics.forward(*odd).pos_w.unflatten(0, (shape[0] // 2, shape[1]))
        return Imagined(
            motion=motion,
            reference=Motion(*(part.unflatten(0, shape) for part in reference_motion(rows))),
            points_m=points,
            reference_points_m=rows.body_pos_w.unflatten(0, shape)[1::2],
            feet=self._feet,
            torque_share=self._kp_share * (targets - q) - self._kd_share * speed,
            wish_change=torch.cat([torch.zeros_like(wishes[:1]), wishes[1:] - wishes[:-1]]),
            steered=shows(goal, "steer").float(),
        )

    def _alive(self, s: Imagined) -> Tensor:
        """(H, B) 1 until a robot is lost."""
        with torch.no_grad():
            tilt = projected_gravity(s.motion.quat_wxyz) - projected_gravity(s.reference.quat_wxyz)
            off = s.motion.pos_w - s.reference.pos_w
            lost = self._settings.lost
            kept = (
                (tilt.norm(dim=-1) <= lost.tilt)
                & (off[..., 2].abs() <= lost.height_m)
                & (off[..., :2].norm(dim=-1) <= lost.place_m)
            )
            return kept.float().cumprod(dim=0)


def _before(start: Start) -> Motion:
    """The states a step before the start; what has just begun was as it is."""
    begun = start.age[:, None] == 0
    return Motion(*(torch.where(begun, now, past[0]) for now, past in zip(start.motion, start.past, strict=True)))
