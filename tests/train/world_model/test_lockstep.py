"""The numbers do not depend on who is faster, nor on whether the run was interrupted."""

import multiprocessing
import time
from pathlib import Path

import pytest
import torch

from tests.train.world_model.small import iterate, small
from train.checkpoint import load_state, save_state

WARM_UP = 12  # iterations of collecting and fitting before the first round
ROUNDS = 5


def run(*overrides, iterations):
    env, learner = small(*overrides)
    _, rows = iterate(env, learner, env.reset(), iterations)
    weights = {name: value.clone() for name, value in learner.weights.items()}
    learner.close()
    return rows, weights


def same(first, second):
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def test_two_processes_give_the_numbers_of_one():
    alone_rows, alone = run("world_model.processes=1", iterations=WARM_UP + ROUNDS)
    beside_rows, beside = run("world_model.processes=2", iterations=WARM_UP + ROUNDS)
    assert alone_rows == beside_rows
    assert same(alone, beside)
    assert any("imagined/cost" in row for row in alone_rows)


def test_what_is_foretold_is_told_between_rounds_and_changes_nothing(monkeypatch):
    """By the process of the policy as by this one; SMALL has rounds of two iterations."""
    quiet, _ = run("world_model.processes=1", iterations=WARM_UP + ROUNDS)
    monkeypatch.setattr("train.world_model.learner.COMPARE_ROUNDS", 1)
    alone, weights = run("world_model.processes=1", iterations=WARM_UP + ROUNDS)
    beside, others = run("world_model.processes=2", iterations=WARM_UP + ROUNDS)
    assert alone == beside and same(weights, others)
    told = [any(name.startswith("foretold/") for name in row) for row in alone]
    in_rounds = sum("model/window_loss" in row for row in alone)
    assert sum(told) == in_rounds // 2 > 0 and all(
        "open_loop/joint_pos_16" in row for row, yes in zip(alone, told) if yes
    )
    rest = [{k: v for k, v in row.items() if not k.startswith(("foretold/", "open_loop/"))} for row in alone]
    assert rest == quiet


def test_what_is_judged_within_a_round_stays_as_it_was_handed_over():
    """Until the round ends, whatever the other process has done by then; SMALL has rounds of two iterations."""
    judged = []
    for processes in (1, 2):
        env, learner = small(f"world_model.processes={processes}")
        iterate(env, learner, env.reset(), WARM_UP + 2)
        judged.append({name: value.clone() for name, value in learner.weights.items()})
        newest = learner.state_dict()["average"]["weights"]  # the other process is done
        assert same(learner.weights, judged[-1]) and not same(newest, judged[-1])
        learner.close()
    assert same(*judged)


def test_what_is_judged_is_in_full_precision_as_it_is_deployed():
    """Products of bf16 are off by a share of up to 2^-9; the graph that is exported has none."""
    _, low = small("world_model.processes=1", "precision=bf16")
    _, full = small("world_model.processes=1", "precision=fp32")
    weights = {name: 0.1 * torch.ones_like(value) for name, value in full.weights.items()}
    seen = torch.linspace(-1.0, 1.0, full.actor_with(weights).observation_size)[None]
    assert torch.equal(low.actor_with(weights)(seen), full.actor_with(weights)(seen))


@pytest.mark.parametrize("at", [3, WARM_UP + 1, WARM_UP + 2], ids=["warm-up", "within a round", "between rounds"])
def test_a_continued_run_goes_on_to_the_same_numbers(at, tmp_path):
    env, learner = small("world_model.processes=1")
    observations, _ = iterate(env, learner, env.reset(), at)
    saved = save_state({"env": env.state_dict(), "learner": learner.state_dict(), "observations": dict(observations)})
    _, wanted = iterate(env, learner, observations, ROUNDS)

    env, learner = small("world_model.processes=1")
    state = load_state(saved, tmp_path)
    learner.load_state_dict(state["learner"])
    env.load_state_dict(state["env"])
    _, rows = iterate(env, learner, state["observations"], ROUNDS)
    assert rows == wanted


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


def test_who_learns_the_policy_is_missed_when_it_has_ended():
    env, learner = small("world_model.processes=2")
    observations, _ = iterate(env, learner, env.reset(), WARM_UP)
    learner._partner._process.kill()
    with pytest.raises(RuntimeError, match="process that learns the policy has ended"):
        iterate(env, learner, observations, 2)
