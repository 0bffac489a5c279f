"""The stress table: each row is what the same condition gives when it is asked for alone."""

import json
from pathlib import Path

import pytest

from core.errors import InputError
from sim2sim.cli import main
from sim2sim.evaluation import evaluate
from sim2sim.player import Player
from sim2sim.request import EvaluationRequest
from sim2sim.stress import Condition, load_conditions, stress, stress_document, stress_table
from tests.sim2sim.toys import write_still_actor

SLIPPERY = Condition("slippery", "reference", 2, friction=0.3)
KICKED = Condition("kicked", "default", 1, delay_ms=20.0, push_m_s=0.5)


def played(request: EvaluationRequest):
    return evaluate(Player(request), workers=1)


def test_rows_are_what_each_condition_gives_alone(still: str) -> None:
    rows = stress(EvaluationRequest((still,), start_noise_rad=0.02, seed=3), [SLIPPERY, KICKED], played)
    alone = EvaluationRequest(
        (still,), sim="default", start_noise_rad=0.02, delay_s=0.02, push_m_s=0.5, episodes=1, seed=3
    )
    document = stress_document(rows)["conditions"]
    assert [entry["name"] for entry in document] == ["slippery", "kicked"]
    assert document[1]["result"] == played(alone).document()
    assert document[0]["result"]["episodes"] == 2 and document[0]["result"]["sim"] == "reference"


def test_another_model_belongs_to_the_reference_simulation() -> None:
    asked = EvaluationRequest(("a",), sim_model=Path("robot.xml"))
    assert SLIPPERY.of(asked).sim_model == Path("robot.xml")
    assert KICKED.of(asked).sim_model is None


def test_the_table_counts_falls_per_policy_and_condition(still: str, tmp_path: Path) -> None:
    offsets = {f"{side}_{joint}_joint": 0.7 for side in ("left", "right") for joint in ("hip_pitch", "ankle_pitch")}
    falling = str(write_still_actor(tmp_path / "falling.onnx", 3.0, offsets))
    table = stress_table(stress(EvaluationRequest((still, falling)), [SLIPPERY], played))
    first, second = table.split("\n\n")[:2]
    assert "slippery" in first and "0 of 2" in first
    assert "2 of 2" in second


def test_bundled_conditions_are_those_that_benchmarks_report() -> None:
    conditions = {condition.name: condition for condition in load_conditions()}
    assert conditions["delay 40 ms"].delay_ms == 40.0 and conditions["friction 0.4"].friction == 0.4
    assert conditions["nominal"] == Condition("nominal", "reference", 24)
    assert conditions["randomised"].randomize and conditions["randomised"].episodes == 100


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ("sim: other", "sim: unknown choice, got other, expected one of default, reference"),
        ("episodes: 0", "episodes: too small, got 0, expected at least 1"),
        ("friction: -1.0", "friction: too small, got -1.0, expected at least 0"),
        ("delay_ms: .nan", "delay_ms: not finite, got nan, expected a finite number"),
    ],
)
def test_impossible_conditions_are_refused(tmp_path: Path, wrong: str, text: str) -> None:
    path = tmp_path / "mine.yaml"
    lines = {"sim": "sim: default", "episodes": "episodes: 1", wrong.split(":")[0]: wrong}
    path.write_text(f"conditions: [{{name: icy, {', '.join(lines.values())}}}]")
    with pytest.raises(InputError) as caught:
        load_conditions(str(path))
    assert str(caught.value) == f"{path}: conditions[0 icy].{text}"


def test_command(still: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setattr("sim2sim.cli.load_conditions", lambda: (KICKED,))
    assert main(["--policy", still, "--stress", "--json", str(tmp_path / "rows.json")]) == 0
    assert "kicked" in capsys.readouterr().out
    assert json.loads((tmp_path / "rows.json").read_text())["conditions"][0]["push_m_s"] == 0.5
    assert main(["--policy", still, "--stress", "--delay", "20"]) == 2
    assert "--delay does not go with --stress" in capsys.readouterr().err
