"""A robot that falls in MuJoCo braces, or is without power, before its pelvis is below 0.45 m; one that only staggers
goes on."""

import numpy as np
import pytest

from core.clock import SimulatedClock
from deploy.cell import Cell
from deploy.control.modes import Request
from deploy.episode import place_at_reference
from tests.deploy.toys import ROBOT, SETTINGS, LateBackend, bundled_run
from world.options import load_sim_options

LOW_M = 0.45
PLAYS_S = 3.0
LANDS_S = 1.1


class Kicked:
    """The plan: kick or slow the loop down at a tick, watch for 3 s, or until it has landed. The simulation judges.

    stiffness_when_low: the largest kp when the pelvis passes 0.45 m, as a share of the robot's own; None: it does not.
    """

    failure = None

    def __init__(self, backend, at_tick, velocity_xy, late):
        self._backend, self._at_tick, self._velocity_xy, self._late = backend, at_tick, velocity_xy, late
        self._tick = -1
        self.lowest_m = np.inf
        self.stiffness_when_low = None
        self._low_at = None

    def requests(self, state):
        self._tick += 1
        data = self._backend.data
        if self._tick == self._at_tick:
            data.qvel[:2] += self._velocity_xy
            self._backend.late = self._late
        self.lowest_m = min(self.lowest_m, data.qpos[2])
        if data.qpos[2] < LOW_M and self._low_at is None:
            self._low_at, self.stiffness_when_low = self._tick, self.stiffness
        over = self._tick > (self._at_tick + PLAYS_S / 0.02 if self._low_at is None else self._low_at + LANDS_S / 0.02)
        return (Request.QUIT,) if over else ()

    @property
    def stiffness(self):
        return float((-self._backend.model.actuator_biasprm[:, 1] / ROBOT.kp).max())


def kick(name, at_tick, velocity_xy, late=False):
    clock = SimulatedClock()
    actor = bundled_run(name)
    cell = Cell(ROBOT, SETTINGS, [actor])
    with LateBackend(ROBOT, clock, load_sim_options("default"), gantry=False, scene=actor.scene) as backend:
        place_at_reference(backend, actor, 0.0, np.random.default_rng(0))
        cell.start_tracking()
        plan = Kicked(backend, at_tick, np.array(velocity_xy), late)
        cell.loop(backend, clock, plan=plan).run()
        plan.stiffness_after = plan.stiffness
    assert cell.guard.counts["implausible"] == 0, "what truly happened is believed"
    return cell.machine.fault, plan


FALLS = {
    "at rest, forwards": ("stand", 40, (2.5, 0.0)),
    "at rest, backwards": ("stand", 40, (-2.5, 0.0)),
    "at rest, to the left": ("stand", 40, (0.0, 2.4)),
    "at rest, to the right": ("stand", 40, (0.0, -2.0)),
    "side_kick, forwards": ("side_kick", 180, (2.0, 0.0)),
    "charleston, backwards": ("charleston", 250, (-2.0, 0.0)),
    "taichi, to the left": ("taichi", 250, (0.0, 3.0)),
    "horse_stance_punch, to the right": ("horse_stance_punch", 200, (0.0, -3.0)),
    "horse_stance_punch, backwards": ("horse_stance_punch", 200, (-1.8, 0.0)),
    "side_kick, a late loop": ("side_kick", 40, (0.0, 0.0), True),
}


@pytest.mark.parametrize("fall", FALLS.values(), ids=FALLS)
def test_it_braces_or_is_without_power_before_the_pelvis_is_low(fall):
    """A late loop cannot brace. Power is off once it has landed."""
    fault, plan = kick(*fall)
    assert plan.lowest_m < LOW_M, "it did not fall"
    assert fault is not None and fault.rule in ("tilt", "base_rate", "overrun")
    expected = 0.0 if fault.rule == "overrun" else 0.2
    assert plan.stiffness_when_low == pytest.approx(expected) and plan.stiffness_after == 0.0


@pytest.mark.parametrize("velocity_xy", [(1.2, 0.0), (-1.0, 0.0), (0.0, 1.2), (0.0, -1.0)])
def test_a_kick_that_is_balanced_ends_nothing(velocity_xy):
    fault, plan = kick("stand", 40, velocity_xy)
    assert fault is None and plan.lowest_m > 0.7
