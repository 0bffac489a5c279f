"""The learner: collects with the averaged policy, fits the world model, and has the policy learn in it meanwhile."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from robot.robot import Robot
from train.interface import StepResult
from train.learner.networks import ActorNetwork
from train.learner.transfer import copy_weights, misfits
from train.mdp.draws import normal
from train.mdp.tracking import ACTION_SCALE, CONTROL_PERIOD_S, TrackingEnv
from train.world_model.blindness import BlindSpot, blind_spots
from train.world_model.comparison import Comparison
from train.world_model.context import packed_context
from train.world_model.fitting import ModelFitting
from train.world_model.partner import Partner
from train.world_model.policy_learning import PolicyLearning, cosine
from train.world_model.ring import Ring, Steps
from train.world_model.settings import WARM_UP_CHUNK, WorldModelSettings
from train.world_model.state import motion_of, pack

COMPARE_ROUNDS = 25


class WorldModelLearner:
    """See :class:`train.learner.learner.Learner`.

    A round is ``settings.round`` iterations here and ``settings.policy.updates`` updates of the policy beside them. At
    its beginning both sides hand over what they have: the world model, the averaged policy, what may be sampled. So the
    numbers do not depend on who is faster.

    Args:
        settings: all of them.
        env: where robots act; its state is read beside what it returns.
        ring: what they did; its memory is shared with ``partner``.
        fitting: of the world model.
        actor: the averaged policy as it is judged; its memory is shared with ``partner``.
        handed_over: the world model as ``partner`` sees it; shared memory.
        partner: carries out calls of :class:`PolicySide`.
        iterations: of the whole run, over which the learning rate falls.
        generator: source of the noise on actions.
    """

    def __init__(
        self,
        settings: WorldModelSettings,
        env: TrackingEnv,
        ring: Ring,
        fitting: ModelFitting,
        actor: ActorNetwork,
        handed_over: nn.Module,
        partner: Partner,
        iterations: int,
        generator: torch.Generator,
    ) -> None:
        self.horizon, self._settings, self.env = settings.collect.steps, settings, env
        self.ring, self.fitting, self._actor = ring, fitting, actor
        self._acting, self._handed_over, self._partner = copy.deepcopy(actor), handed_over, partner
        self._iterations, self._generator = iterations, generator
        self._noise_std = by_robot(settings.collect.noise_rad, env)[:, None]
        self._noise = torch.zeros(env.num_envs, env.num_actions, device=env.device)
        self._segment = torch.zeros(env.num_envs, dtype=torch.long, device=env.device)
        self._begun, self._fitted, self._in_round, self._under_way, self._updates = False, 0, 0, False, 0
        self._model_known = False
        self._figures: dict[str, float] = {}

    @property
    def weights(self) -> Mapping[str, Tensor]:
        """See the protocol. Within a round those that act: the others' change meanwhile."""
        return (self._acting if self._in_round else self._actor).state_dict()

    def actor_with(self, weights: Mapping[str, Tensor]) -> ActorNetwork:
        """See the protocol."""
        actor = self._actor.deployed()
        actor.load_state_dict(weights)
        return actor

    @torch.no_grad()
    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        """See the protocol."""
        memory = self._settings.collect.noise_memory
        fresh = normal(self._noise.shape, 1.0, self._generator, self._noise.device) * self._noise_std
        self._noise = memory * self._noise + (1.0 - memory**2) ** 0.5 * fresh
        action = self._acting(observations["actor"]) + self._noise / ACTION_SCALE
        self._remember(action)
        return action

    def _remember(self, action: Tensor) -> None:
        env, state = self.env, self.env.state
        self.ring.write(
            Steps(
                state=pack(motion_of(state.physics)),
                target=env.targets_of(action),
                context=packed_context(
                    env.simulator, state.sensing, env.settings.simulation.substeps, CONTROL_PERIOD_S
                ),
                clip=state.clip,
                tick=state.tick,
                age=state.episode_steps,
                goal=state.goal,
                segment=self._segment,
            )
        )

    def record(self, result: StepResult) -> None:
        """See the protocol."""
        ended = result.terminated | result.timed_out
        self._segment += ended | self.env.disturbed
        self._noise[ended] = 0.0

    def update(self, observations: Mapping[str, Tensor]) -> dict[str, float]:
        """See the protocol."""
        self._updates += 1
        self._redraw()
        fit, done = self._settings.fitting, self.ring.count * self.ring.num_envs
        if not self._begun:
            if done < fit.warm_up_steps:
                return {"warm_up": done / fit.warm_up_steps}
            self._begin()
        return self._warm_up() if self._fitted < fit.warm_up_updates else self._round()

    def _begin(self) -> None:
        """Enough is known to normalise by."""
        if not self.fitting.normalized:
            self.fitting.normalize()
        self._call("normalize", *self._handed())
        self._begun = True

    def _redraw(self) -> None:
        """Physical constants change within no window."""
        if self._updates % self._settings.collect.redraw_every == 0:
            self.env.simulator.redraw()
            self._segment += 1

    def _warm_up(self) -> dict[str, float]:
        fit = self._settings.fitting
        for _ in range(WARM_UP_CHUNK):
            single = self._fitted < fit.warm_up_single
            size = (1, fit.single_batch) if single else (fit.warm_up_length, fit.window_batch)
            loss = self.fitting.update(*size)
            self._fitted += 1
        return {"model/loss": float(loss)}

    def _round(self) -> dict[str, float]:
        fit = self._settings.fitting
        if self._in_round == 0:
            self._hand_over()
            self._partner.begin("round", *self._handed(), self._rounds())
            self._under_way = True
        self.fitting.set_rate(cosine(self._updates / self._iterations))
        for _ in range(fit.single_updates):
            single = self.fitting.update(1, fit.single_batch)
        for _ in range(fit.window_updates):
            window = self.fitting.update(fit.window, fit.window_batch)
        self._in_round = (self._in_round + 1) % self._settings.round
        if self._in_round == 0:
            self._settle()
        losses = {"model/single_loss": float(single), "model/window_loss": float(window)}
        return {**losses, "model/skipped": float(self.fitting.skipped), **self._figures, **self._compared()}

    def _compared(self) -> dict[str, float]:
        """What the world model foretells beside what happened; between rounds, every few of them."""
        if self._in_round or self._updates // self._settings.round % COMPARE_ROUNDS:
            return {}
        compared: dict[str, float] = self._call("compare", self.ring.next, self.ring.count)
        return compared

    def _hand_over(self) -> None:
        """Both sides are idle: the world model goes there, the averaged policy comes here."""
        self._handed_over.load_state_dict(self.fitting.model.state_dict())
        self._acting.load_state_dict(self._actor.state_dict())

    def _handed(self) -> tuple[int, int, Tensor]:
        """What may be sampled, and where robots fail."""
        return self.ring.next, self.ring.count, self.env.command.hard()

    def _rounds(self) -> int:
        """Of the whole run."""
        return self._settings.rounds(self._iterations, self.env.num_envs, model_known=self._model_known)

    def _settle(self) -> None:
        """Wait for the policy's side."""
        if self._under_way:
            self._figures, self._under_way = self._partner.finish(), False

    def _call(self, method: str, *arguments: Any) -> Any:
        self._settle()
        self._partner.begin(method, *arguments)
        return self._partner.finish()

    def start_from(self, networks: Mapping[str, Mapping[str, Tensor]]) -> list[str]:
        """See the protocol. What inputs are normalised by comes with the weights; the model is that of a run.

        InputError also where no model is taken, and the run ends before it has fitted its own.
        """
        taken: list[str] = self._call("start_from", networks)
        model, given = self.fitting.model.state_dict(), networks.get("model", {})
        if given and not misfits(model, given):
            copy_weights(model, given, "model")
            self.fitting.normalized, self._fitted = True, self._settings.fitting.warm_up_updates
            self._model_known = True
            taken.append("model")
        self._settings.check_rounds(self._iterations, self.env.num_envs, model_known=self._model_known)
        self._acting.load_state_dict(self._actor.state_dict())
        return taken

    def beside_actor(self) -> dict[str, Mapping[str, Tensor]]:
        """Weights of what takes long to learn anew: the critic and the world model."""
        return {"critic": self._call("state_dict")["critic"]["network"], "model": self.fitting.model.state_dict()}

    def blind_spots(self, robot: Robot, observations: Mapping[str, Tensor]) -> list[BlindSpot]:
        """Where the world model is wrong; see :func:`blind_spots`. The robots go on from ``observations``."""
        return blind_spots(self, robot, observations)

    def close(self) -> None:
        """See the protocol."""
        self._partner.close()

    def state_dict(self) -> dict[str, Any]:
        """See the protocol."""
        policy = self._call("state_dict")
        return {
            "policy": policy,
            "average": {"weights": self._actor.state_dict()},
            "critic": policy["critic"]["network"],
            "fitting": self.fitting.state_dict(),
            "ring": self.ring.state_dict(),
            "acting": self._acting.state_dict(),
            "handed_over": self._handed_over.state_dict(),
            "noise": self._noise,
            "segment": self._segment,
            "counters": [int(self._begun), self._fitted, self._in_round, self._updates, int(self._model_known)],
            "figures": self._figures,
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See the protocol."""
        self._call("load_state_dict", state["policy"])
        self.fitting.load_state_dict(state["fitting"])
        self.ring.load_state_dict(state["ring"])
        self._acting.load_state_dict(state["acting"])
        self._handed_over.load_state_dict(state["handed_over"])
        for name in ("noise", "segment"):
            getattr(self, f"_{name}").copy_(state[name])
        begun, self._fitted, self._in_round, self._updates, known = state["counters"]
        self._begun, self._model_known = bool(begun), bool(known)
        self._figures = dict(state["figures"])
        self._generator.set_state(state["generator"])


def by_robot(values: Sequence[float], env: TrackingEnv) -> Tensor:
    """One of the values (B,) for each robot, in turn."""
    return torch.tensor([values[robot % len(values)] for robot in range(env.num_envs)], device=env.device)


class PolicySide:
    """What the learner's partner carries out: policy learning on a ring whose end is told with each call."""

    def __init__(self, learning: PolicyLearning, ring: Ring, comparison: Comparison) -> None:
        self._learning, self._ring, self._comparison = learning, ring, comparison

    def normalize(self, following: int, count: int, hard: Tensor) -> None:
        """See :meth:`PolicyLearning.normalize`."""
        self._ring.next, self._ring.count = following, count
        self._learning.normalize(hard)

    def round(self, following: int, count: int, hard: Tensor, rounds: int) -> dict[str, float]:
        """See :meth:`PolicyLearning.round`."""
        self._ring.next, self._ring.count = following, count
        return self._learning.round(hard, rounds)

    def compare(self, following: int, count: int) -> dict[str, float]:
        """See :class:`Comparison`."""
        self._ring.next, self._ring.count = following, count
        return self._comparison.figures(self._learning.averaged, self._learning.model)

    def start_from(self, networks: Mapping[str, Mapping[str, Tensor]]) -> list[str]:
        """See :meth:`PolicyLearning.start_from`."""
        return self._learning.start_from(networks)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`PolicyLearning.state_dict`."""
        return self._learning.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """See :meth:`PolicyLearning.load_state_dict`."""
        self._learning.load_state_dict(state)
