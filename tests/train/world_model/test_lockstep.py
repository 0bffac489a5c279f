"""The numbers do not depend on who is faster, nor on whether the run was interrupted."""

import multiprocessing
import time
from pathlib import Path

import pytest
import torch

from tests.train.world_model.small import WARM_UP, going_on, iterate, saved, small

ROUNDS = 5  # iterations: two rounds, and half of one
AT = {"collecting": WARM_UP - 1, "fitted": WARM_UP, "between rounds": WARM_UP + 2, "within a round": WARM_UP + 3}


@pytest.fixture(scope="module")
def alone():
    """In one process: the learner after WARM_UP and ROUNDS iterations, their rows, and checkpoints after some."""
    env, learner = small("world_model.processes=1")
    observations, rows, checkpoints = env.reset(), [], {}
    for iteration in range(1, WARM_UP + ROUNDS + 1):
        observations, (row,) = iterate(env, learner, observations, 1)
        rows.append(row)
        if iteration in AT.values():
            checkpoints[iteration] = saved(env, learner, observations)
    return learner, rows, checkpoints


@pytest.fixture(scope="module")
def beside():
    """The same in two processes."""
    env, learner = small("world_model.processes=2")
    _, rows = iterate(env, learner, env.reset(), WARM_UP + ROUNDS)
    yield learner, rows
    learner.close()


def same(first, second):
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def test_two_processes_give_the_numbers_of_one(alone, beside):
    assert beside[1] == alone[1]
    assert same(beside[0].weights, alone[0].weights)
    assert sum("imagined/cost" in row for row in alone[1]) == ROUNDS - 1  # from the end of the first round on


def test_what_is_foretold_is_told_between_rounds_and_changes_nothing(alone, monkeypatch):
    """By the process of the policy as by this one; SMALL has rounds of two iterations."""
    learner, quiet, checkpoints = alone
    monkeypatch.setattr("train.world_model.learner.COMPARE_ROUNDS", 1)
    told = []
    for processes in (1, 2):
        env, other, observations = going_on(checkpoints[WARM_UP], f"world_model.processes={processes}")
        told.append(iterate(env, other, observations, ROUNDS)[1])
        assert same(other.weights, learner.weights)
        other.close()
    assert told[0] == told[1]
    has = [[any(name.startswith(kind) for name in row) for row in told[0]] for kind in ("foretold/", "open_loop/")]
    assert has == 2 * [[False, True, False, True, False]] and "open_loop/joint_pos_16" in told[0][1]
    rest = [{k: v for k, v in row.items() if not k.startswith(("foretold/", "open_loop/"))} for row in told[0]]
    assert rest == quiet[WARM_UP:]


def test_what_is_judged_within_a_round_stays_as_it_was_handed_over(alone, beside):
    """Until the round ends, whatever the other process has done by then; ROUNDS ends within one."""
    for learner in (alone[0], beside[0]):
        judged = {name: value.clone() for name, value in learner.weights.items()}
        newest = learner.state_dict()["average"]["weights"]  # the other process is done
        assert same(learner.weights, judged) and not same(newest, judged)


def test_what_is_judged_is_in_full_precision_as_it_is_deployed():
    """Products of bf16 are off by a share of up to 2^-9; the graph that is exported has none."""
    _, low = small("world_model.processes=1", "precision=bf16")
    _, full = small("world_model.processes=1", "precision=fp32")
    weights = {name: 0.1 * torch.ones_like(value) for name, value in full.weights.items()}
    seen = torch.linspace(-1.0, 1.0, full.actor_with(weights).observation_size)[None]
    assert torch.equal(low.actor_with(weights)(seen), full.actor_with(weights)(seen))


@pytest.mark.parametrize("at", AT.values(), ids=AT)
def test_a_continued_run_goes_on_to_the_same_numbers(alone, at):
    _, rows, checkpoints = alone
    env, learner, observations = going_on(checkpoints[at], "world_model.processes=1")
    iterations = min(4, len(rows) - at)
    _, gone_on = iterate(env, learner, observations, iterations)
    assert gone_on == rows[at : at + iterations]


def test_who_learns_the_policy_ends_with_who_trains():
    """Also when that is killed, and other processes hold the pipe between them."""
    context = multiprocessing.get_context("fork")
    told, tell = context.Pipe(duplex=False)

    def train() -> None:
        first, second = (small("world_model.processes=2")[1] for _ in range(2))
        tell.send([learner._partner._process.pid for learner in (first, second)])
        time.sleep(60.0)

    trainer = context.Process(target=train)
    trainer.start()
    partners = told.recv()
    trainer.kill()
    trainer.join()
    deadline_s = time.monotonic() + 10.0
    while any(is_alive(pid) for pid in partners) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert not any(is_alive(pid) for pid in partners)


def is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.parametrize("at", ["before a round", "within a round"])
def test_who_learns_the_policy_is_missed_when_it_has_ended(alone, at):
    """Be it before a round, or with one under way."""
    env, learner, observations = going_on(alone[2][WARM_UP], "world_model.processes=2")
    if at == "within a round":
        observations, _ = iterate(env, learner, observations, 1)
    learner._partner._process.kill()
    learner._partner._process.join()
    with pytest.raises(RuntimeError, match="process that learns the policy has ended"):
        iterate(env, learner, observations, 2)
