"""Receding-horizon iLQR: the robot is led along a motion tick by tick, each time with a fresh plan of a few ticks.

One linear feedback for the whole motion throws the robot away where a foot lifts, because contacts come and go
elsewhere than where the slopes were taken. A plan of 0.16 s starts in the state in which the robot is, with the slopes
of where it goes; what comes after it is the quadratic cost to go of the motion before (Tassa, Erez, Todorov 2012,
"Synthesis and stabilization of complex behaviors through online trajectory optimization").
"""

from dataclasses import dataclass, replace

import numpy as np

from train.priors.plant import LINEARIZE_EVERY, Motion, PriorPlant, Slopes, difference, joined

REPLAN_EVERY = 2
STEP_SIZES = np.array([1.0, 0.7, 0.5, 0.3, 0.15, 0.07, 0.02])
FEEDBACK_MAX = 3.0
# A robot this far from where it should be has been thrown aside, even where a later tick brings it back.
LOST_M = 0.25


@dataclass(frozen=True)
class Value:
    """Cost to go ½ dᵀ curvature d + slope·d, d the deviation (2nv,) from a state."""

    qpos: np.ndarray
    qvel: np.ndarray
    curvature: np.ndarray
    slope: np.ndarray

    def deviation(self, motion: Motion) -> np.ndarray:
        """Of the motion's last state."""
        return np.concatenate([difference(motion.qpos[-1], self.qpos), motion.qvel[-1] - self.qvel])

    def cost(self, motion: Motion) -> float:
        """Of the motion's last state."""
        d = self.deviation(motion)
        return float(0.5 * d @ self.curvature @ d + self.slope @ d)


@dataclass(frozen=True)
class Objective:
    """Half the weighted squares of deviations from ``wanted``: weights of states (2nv,) and of commands (J+6,)."""

    wanted: Motion
    state: np.ndarray
    command: np.ndarray

    def part(self, start: int, end: int) -> "Objective":
        """Of the ticks from ``start`` to ``end``."""
        return replace(self, wanted=self.wanted.part(start, end))

    def end(self) -> Value:
        """What deviating from the last wanted state costs."""
        nv = len(self.state)
        return Value(self.wanted.qpos[-1], self.wanted.qvel[-1], np.diag(self.state), np.zeros(nv))

    def cost(self, motion: Motion, end: Value) -> float:
        """Of a motion and of where it ends; infinite where physics has diverged."""
        if motion.diverged():
            return np.inf
        states = (motion.deviation(self.wanted)[:-1] ** 2 * self.state).sum()
        commands = ((motion.command - self.wanted.command) ** 2 * self.command).sum()
        return 0.5 * float(states + commands) + end.cost(motion)


@dataclass(frozen=True)
class Policy:
    """Feedback (T, J+6, 2nv) and correction (T, J+6) of a motion's commands, and the cost to go of its states."""

    feedback: np.ndarray
    correction: np.ndarray
    curvature: np.ndarray
    slope: np.ndarray

    def value(self, motion: Motion, tick: int) -> Value:
        """Cost to go from the motion's state at a tick."""
        return Value(motion.qpos[tick], motion.qvel[tick], self.curvature[tick], self.slope[tick])


def follow(plant: PriorPlant, objective: Objective, motion: Motion, horizon: int) -> Motion | None:
    """Lead the robot from the motion's first state to its end, at the least cost that plans of ``horizon`` ticks find.

    Args:
        plant: the robot.
        objective: what deviations from the wanted motion cost.
        motion: what the last pass made, or the wanted motion itself.
        horizon: ticks of a plan.

    Returns:
        a motion that physics makes from its commands, or ``None`` where the robot got lost.
    """
    whole = backward(plant.linearize(motion), motion, objective, objective.end())
    plan, made = motion.part(0, 0), []
    for tick in range(0, len(motion), REPLAN_EVERY):
        end = min(tick + horizon, len(motion))
        plan = _extended(plant, plan, motion, whole, tick, end)
        plan = _improved(plant, plan, objective.part(tick, end), whole.value(motion, end))
        step = min(REPLAN_EVERY, len(plan))
        made.append(plan.part(0, step))
        plan = plan.part(step, len(plan))
        away = np.linalg.norm(plan.qpos[0, :3] - objective.wanted.qpos[tick + step, :3])
        if not away < LOST_M:
            return None
    return joined(made)


def _extended(plant: PriorPlant, plan: Motion, motion: Motion, policy: Policy, tick: int, end: int) -> Motion:
    """The plan from ``tick``, led on to ``end`` by the feedback of the whole motion."""
    start = tick + len(plan)
    if start == end:
        return plan
    feedback = policy.feedback[start:end]
    unchanged = np.zeros((1, *feedback.shape[:2]))
    rest = _play(plant, plan.qpos[-1], plan.qvel[-1], motion.part(start, end), feedback, unchanged)
    return joined([plan, *rest])


def _improved(plant: PriorPlant, plan: Motion, objective: Objective, end: Value) -> Motion:
    """One iteration of iLQR; the plan itself where no step is better."""
    policy = backward(plant.linearize(plan), plan, objective, end)
    steps = STEP_SIZES[:, None, None] * policy.correction
    tried = _play(plant, plan.qpos[0], plan.qvel[0], plan, policy.feedback, steps)
    return min([plan, *tried], key=lambda made: objective.cost(made, end))


def _play(
    plant: PriorPlant, qpos: np.ndarray, qvel: np.ndarray, motion: Motion, feedback: np.ndarray, steps: np.ndarray
) -> list[Motion]:
    """Play a motion's commands less each of ``steps`` (n, T, J+6), under feedback, from a state."""
    states, rates, commands = [np.repeat(qpos[None], len(steps), 0)], [np.repeat(qvel[None], len(steps), 0)], []
    for tick, command in enumerate(motion.command):
        deviation = np.hstack([difference(states[-1], motion.qpos[tick]), rates[-1] - motion.qvel[tick]])
        back = np.clip(deviation @ feedback[tick].T, -FEEDBACK_MAX, FEEDBACK_MAX)
        commands.append(command - steps[:, tick] - back)
        after = plant.advance(states[-1], rates[-1], commands[-1])
        states.append(after[0])
        rates.append(after[1])
    made = [np.stack(values, axis=1) for values in (states, rates, commands)]
    return [Motion(*(values[i] for values in made)) for i in range(len(steps))]


def backward(slopes: Slopes, motion: Motion, objective: Objective, end: Value) -> Policy:
    """Riccati recursion along a motion, from the cost to go of its last state."""
    deviation = motion.deviation(objective.wanted)
    excess = objective.command * (motion.command - objective.wanted.command)
    feedback, correction = np.empty((*excess.shape, len(objective.state))), np.empty_like(excess)
    curvature, slope = end.curvature, end.slope + end.curvature @ end.deviation(motion)
    curvatures, gradients = [curvature], [slope]
    for tick in range(len(excess) - 1, -1, -1):
        step_a, step_b = slopes.state[tick // LINEARIZE_EVERY], slopes.command[tick // LINEARIZE_EVERY]
        slope = slope + curvature @ slopes.gap[tick]
        ahead = curvature @ step_a
        mixed = step_b.T @ ahead
        solved = np.linalg.solve(
            np.diag(objective.command) + step_b.T @ curvature @ step_b,
            np.column_stack([mixed, excess[tick] + step_b.T @ slope]),
        )
        feedback[tick], correction[tick] = solved[:, :-1], solved[:, -1]
        slope = objective.state * deviation[tick] + step_a.T @ slope - mixed.T @ correction[tick]
        curvature = np.diag(objective.state) + step_a.T @ ahead - mixed.T @ feedback[tick]
        curvature = 0.5 * (curvature + curvature.T)
        curvatures.append(curvature)
        gradients.append(slope)
    return Policy(feedback, correction, np.array(curvatures[::-1]), np.array(gradients[::-1]))
