"""The bundled actor along the example: a square, a stop and two clips, in simulated time."""

from core.config import CONFIGS
from tests.deploy.goals.test_runs import played


def test_the_bundled_actor_walks_a_square_stops_and_plays_two_clips(capsys):
    """What came before a clip leaves its joint errors what they are from its start, within a fifth; bodies near."""
    common = ["--backend", "mujoco", "--policy", "goals", "--fast", "--goal"]
    report, said = played([*common, f"script:{CONFIGS / 'goals' / 'square_and_clips.yaml'}"], capsys)
    assert report.outcome == "completed" and report.content["fell"] is False
    assert report.content["heading_error_rad"] < 0.05
    # The stand actor takes over at the end, so that the robot is lowered and does not fall.
    assert said.split("READY\n")[1].splitlines()[:4] == ["TRACKING", "HOLD", "LOWERING", "damping"]
    clips = {clip["motion"]: clip["metrics"] for clip in report.content["clips"]}
    assert list(clips) == ["horse_stance_punch", "side_kick"]
    alone, _ = played([*common, "clip:side_kick", "--start", "reference"], capsys)
    after, standing = clips["side_kick"], alone.content["metrics"]
    assert abs(after["empjpe_mrad"]["mean"] / standing["empjpe_mrad"]["mean"] - 1.0) < 0.2
    assert max(standing["empbpe_mm"]["mean"], after["empbpe_mm"]["mean"]) < 18.0
