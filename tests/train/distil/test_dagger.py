"""A linear teacher is recovered by who acts for himself, and not by who only looks on."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from core.structured import parse
from train.distil.learner import DistilLearner, Generators
from train.distil.losses import Prediction
from train.distil.settings import DistilSettings
from train.interface import StepResult
from train.learner.networks import ActorNetwork, Residual

ROBOTS, EPISODE = 16, 8
GAIN = torch.tensor([[-0.5, 0.3], [0.0, -0.8]])  # action = GAIN @ state
CPU = torch.device("cpu")


class Line(Residual):
    input_size = 2

    def __init__(self):
        super().__init__()
        self.output = nn.Linear(2, 2, bias=False)
        with torch.no_grad():
            self.output.weight.copy_(torch.tensor([[0.2, -0.1], [0.4, 0.1]]))

    def forward(self, x):
        return self.output(x)


class LinearStudent(nn.Module):
    """Acts in one way, and knows of no latent."""

    ways, noise_size = ("prior",), 0

    def __init__(self):
        super().__init__()
        self.actor = ActorNetwork(Line(), 2, (1.0, 1.0, 1.0))

    def look(self, observations):
        return {"actor": observations["actor"]}

    def act(self, way, seen, noise):
        return self.actor(seen["actor"])

    def predict(self, samples):
        action = self.actor(samples["actor"])
        return Prediction(action, action, samples["label"], torch.zeros(()))

    def normalize(self, samples):
        pass

    def beside_actor(self):
        return {}


class Plane:
    """Points that begin on a line, which the teacher never leaves: x' = x + action / 2."""

    def __init__(self):
        self.generator = torch.Generator().manual_seed(3)
        self.state, self.steps = torch.zeros(ROBOTS, 2), 0

    def reset(self):
        on_the_line = torch.randn(ROBOTS, 1, generator=self.generator)
        self.state = torch.cat([on_the_line, torch.zeros(ROBOTS, 1)], dim=1)
        return self.observe()

    def observe(self):
        return {"actor": self.state.clone(), "teacher": self.state.clone()}

    def step(self, actions):
        self.state, self.steps = self.state + 0.5 * actions, self.steps + 1
        ends = torch.full((ROBOTS,), self.steps % EPISODE == 0)
        observations = self.reset() if ends.all() else self.observe()
        nothing = torch.zeros(ROBOTS, 1)
        return StepResult(observations, nothing, torch.zeros(ROBOTS, dtype=torch.bool), ends, nothing[:0], {})


def learner(**acts):
    settings = parse(
        DistilSettings,
        {
            "steps": 8, "capacity": 16384, "batch": 128, "updates": 8, "learning_rate": {"first": 0.02},
            "max_grad_norm": 10.0, "average_iterations": 1, "noise": "episode", "losses": {"action": {"first": 1.0}},
            "acts": {name: {"first": share} for name, share in acts.items()},
            "student": {
                "latent": 1, "prior_hidden": [1], "encoder_hidden": [1], "decoder_hidden": [1], "activation": "relu",
                "decoder_sees": "observation",
            },
        },
        "distil",
    )  # fmt: skip
    teacher = nn.Linear(2, 2, bias=False).requires_grad_(False)
    teacher.weight.copy_(GAIN)
    generators = Generators(*(torch.Generator().manual_seed(seed) for seed in range(3)))
    return DistilLearner(settings, LinearStudent(), teacher, ROBOTS, generators, CPU)


def train(student, env, observations, iterations):
    rows = []
    for _ in range(iterations):
        for _ in range(student.horizon):
            result = env.step(student.act(observations))
            student.record(result)
            observations = result.observations
        rows.append(student.update(observations))
    return observations, rows


def test_who_acts_recovers_the_teacher():
    student, env = learner(prior=1.0), Plane()
    _, rows = train(student, env, env.reset(), 80)
    assert torch.allclose(student.weights["mlp.output.weight"], GAIN, atol=0.02)
    assert rows[-1]["distil/action"] < 1e-3 * rows[0]["distil/action"]
    assert (rows[0]["acts/prior"], rows[0]["acts/teacher"]) == (1.0, 0.0)


def test_who_only_looks_on_learns_nothing_of_where_the_teacher_never_is():
    student, env = learner(teacher=1.0), Plane()
    before = student.weights["mlp.output.weight"].clone()
    train(student, env, env.reset(), 80)
    learnt = student.weights["mlp.output.weight"]
    assert torch.allclose(learnt[:, 0], GAIN[:, 0], atol=0.02)
    assert torch.equal(learnt[:, 1], before[:, 1])


def test_the_teacher_labels_whoever_acts_and_acts_where_it_is_its_turn():
    student, env = learner(teacher=1.0, prior=1.0), Plane()
    observations = env.reset()
    actions, rows = student.act(observations), student.mixture.rows()
    assert 0 < len(rows["teacher"]) < ROBOTS
    wanted = observations["actor"] @ GAIN.T
    assert torch.allclose(actions[rows["teacher"]], wanted[rows["teacher"]])
    assert not torch.isclose(actions[rows["prior"]], wanted[rows["prior"]]).all(dim=1).any()
    samples = student.buffer.newest(ROBOTS)
    assert torch.allclose(samples["label"], samples["actor"] @ GAIN.T)


@pytest.mark.parametrize("average", [1, 5])
def test_it_goes_on_to_the_same_numbers(average):
    """Interrupted between iterations, and put together anew."""
    runs = []
    for interrupted in (False, True):
        student, env = learner(teacher=1.0, prior=1.0), Plane()
        student.settings = replace(student.settings, average_iterations=average)
        student.average = student._new_average()
        observations, _ = train(student, env, env.reset(), 3)
        if interrupted:
            state, student = student.state_dict(), learner(teacher=1.0, prior=1.0)
            student.average = type(student.average)(average, student.student.actor.state_dict())
            student.load_state_dict(state)
        runs.append((train(student, env, observations, 4)[1], student.weights["mlp.output.weight"]))
    assert runs[0][0] == runs[1][0] and torch.equal(runs[0][1], runs[1][1])
