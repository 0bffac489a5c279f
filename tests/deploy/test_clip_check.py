"""Clips that an actor gets at run time."""

import contextlib
from dataclasses import replace

import pytest

from core.clock import SimulatedClock
from core.errors import InputError
from deploy.actors import load_runs
from deploy.clip_check import check_clip, rehearse
from deploy.dry_run_record import DryRunRecord
from deploy.episode import Start
from deploy.operator.voice import Voice
from deploy.options import RunOptions
from deploy.preflight import Check, PreflightRefused, table
from deploy.session import run_session
from deploy.settings import load_settings
from motion.clip import save_clip
from motion.clip_set import open_clips
from motion.envelope import TRAINED_ON, envelope_of
from motion.library import open_motion
from motion.reference import build_reference
from robot.robot import load_robot
from sim2sim.evaluation import Evaluation
from sim2sim.player import Player
from sim2sim.request import EvaluationRequest
from tests.deploy.test_session import NoKeyboard, SwitchesAtTick
from tests.sim2sim.toys import save_csv, standing_clip, write_still_actor

ROBOT, SETTINGS = load_robot(), load_settings()


@pytest.fixture
def still(tmp_path):
    """An actor of any clip whose targets are always the default pose, trained on the bundled stand."""
    stand = build_reference(open_motion("stand", ROBOT), ROBOT)
    provenance = {TRAINED_ON: envelope_of([stand], ROBOT)}
    return str(write_still_actor(tmp_path / "still.onnx", any_clip=True, provenance=provenance))


def runs_of(policy, *motions):
    return load_runs([policy], open_clips(motions, ROBOT), ROBOT, SETTINGS.entry)


def test_an_actor_of_any_clip_runs_once_with_each(still, tmp_path):
    save_clip(standing_clip(0.2), tmp_path / "brief.npz")
    runs = runs_of(still, "side_kick", str(tmp_path / "brief.npz"))
    assert [(run.name, run.num_ticks) for run in runs] == [("side_kick", 309), ("brief", 10)]
    with pytest.raises(InputError, match="give --motion"):
        runs_of(still)


def test_a_person_switches_between_clips_and_without_one_several_are_refused(still, tmp_path, monkeypatch):
    for name in ("first", "second"):
        save_clip(standing_clip(0.4), tmp_path / f"{name}.npz")
    motions = tuple(str(tmp_path / f"{name}.npz") for name in ("first", "second"))
    with pytest.raises(InputError, match="several --policy or --motion; add --interactive"):
        run_session(RunOptions("mock", (still,), motions, start=Start.REFERENCE), SwitchesAtTick(-1), Voice())
    monkeypatch.setattr("deploy.operator.people.Keyboard", NoKeyboard)
    monkeypatch.setattr("deploy.session.MonotonicClock", SimulatedClock)
    monkeypatch.setattr("deploy.session.realtime", lambda say: contextlib.nullcontext())
    options = RunOptions("mock", (still,), motions, start=Start.REFERENCE, interactive=True)
    report = run_session(options, SwitchesAtTick(-1), Voice())
    assert report.outcome == "completed" and report.content["motion"] == "first"


def test_a_clip_is_compared_with_what_its_actor_was_trained_on(still, tmp_path):
    kick, stand = runs_of(still, "side_kick", "stand")
    (check,) = check_clip(stand, ROBOT, binding=True)
    assert check.passed and check.what == "clip stand" and check.found == "all within what the actor was trained on"
    (check,) = check_clip(kick, ROBOT, binding=True)
    assert check.passed and "beyond what the actor was trained on, most: " in check.found
    untold = write_still_actor(tmp_path / "untold.onnx", any_clip=True)
    (check,) = check_clip(*runs_of(str(untold), "stand"), ROBOT, binding=True)
    assert check.found == "its actor does not say what it was trained on"


def test_what_nobody_can_perform_is_refused_on_a_real_wire_alone(still, tmp_path):
    clip = standing_clip(2.0)
    flying = clip.root_pos_w.copy()
    flying[:, 2] += 0.5
    save_clip(replace(clip, root_pos_w=flying), tmp_path / "flying.npz")
    (run,) = runs_of(still, str(tmp_path / "flying.npz"))
    real, simulated = (check_clip(run, ROBOT, binding=binding)[0] for binding in (True, False))
    assert not real.passed and simulated.passed
    assert "floating" in real.found and real.found == simulated.found
    assert [line.split()[0] for line in table([real, simulated, Check("x", True, "")]).splitlines()] == [
        "NO", "note", "ok",
    ]  # fmt: skip


def test_a_recording_that_does_not_say_how_fast_it_is_is_pointed_out(still, tmp_path):
    save_csv(standing_clip(1.0), tmp_path / "stand.csv")
    save_clip(open_motion(tmp_path / "stand.csv", ROBOT, csv_fps=30.0), tmp_path / "told.npz")
    untold, told = runs_of(still, str(tmp_path / "stand.csv"), str(tmp_path / "told.npz"))
    (check,) = check_clip(untold, ROBOT, binding=True)
    assert check.passed and check.remarkable
    assert "60 frames per second assumed" in check.found and "motion/process --fps" in check.found
    (check,) = check_clip(told, ROBOT, binding=True)
    assert check.passed and not check.remarkable and "assumed" not in check.found


def test_an_evaluation_says_what_nobody_can_perform(still, tmp_path):
    clip = standing_clip(0.4)
    high = clip.root_pos_w.copy()
    high[:, 2] += 5.0
    save_clip(replace(clip, root_pos_w=high), tmp_path / "high.npz")
    player = Player(EvaluationRequest((still, still), (str(tmp_path / "high.npz"), "stand")))
    told = [line for line in Evaluation(player.request, player, []).remarks() if line.startswith("clip ")]
    assert len(told) == 1 and told[0].startswith("clip high: out of balance: ")


def test_preflight_asks_it_before_anything_is_energised(still, tmp_path, monkeypatch):
    clip = standing_clip(2.0)
    flying = clip.root_pos_w.copy()
    flying[:, 2] += 0.5
    save_clip(replace(clip, root_pos_w=flying), tmp_path / "flying.npz")
    written = []
    monkeypatch.setattr("hal.simulated.mock.MockBackend.write", lambda self, command: written.append(command))
    monkeypatch.setattr("deploy.session._verified", lambda *parts: [])
    monkeypatch.setattr(RunOptions, "on_real_wire", property(lambda self: True))
    options = RunOptions("mock", (still,), (str(tmp_path / "flying.npz"),), first_run_ok=True, start=Start.REFERENCE)
    monkeypatch.setattr(RunOptions, "check", lambda self: None)
    with pytest.raises(PreflightRefused, match=r"preflight refused: clip flying: .*floating"):
        run_session(options, SwitchesAtTick(-1), Voice())
    assert not written


def test_two_clips_of_one_name_are_refused(still, tmp_path):
    (tmp_path / "other").mkdir()
    for folder in (tmp_path, tmp_path / "other"):
        save_clip(standing_clip(0.2), folder / "brief.npz")
    with pytest.raises(InputError, match="two clips of the same name"):
        runs_of(still, str(tmp_path / "brief.npz"), str(tmp_path / "other" / "brief.npz"))


def test_a_rehearsal_passes_where_simulation_ends_with_the_clip_and_says_where_it_does_not(still, tmp_path):
    save_clip(standing_clip(0.3), tmp_path / "brief.npz")
    brief, kick = runs_of(still, str(tmp_path / "brief.npz"), "side_kick")
    said = []
    (check,) = rehearse(brief, ROBOT, SETTINGS, said.append)
    assert check.passed and check.found.startswith("3 of 3 to the end in simulation, ")
    assert said == ["rehearsing brief in simulation, 3 times 0.3 s"]
    (check,) = rehearse(kick, ROBOT, SETTINGS, said.append)
    assert not check.passed and check.found.startswith("0 of 3 to the end in simulation; at ")
    assert rehearse(*runs_of("side_kick"), ROBOT, SETTINGS, said.append) == []  # it carries its clip


def test_a_dry_run_on_a_real_wire_is_refused_before_the_wire_is_opened(still, monkeypatch):
    opened = []
    monkeypatch.setattr("hal.simulated.mock.MockBackend.open", lambda self: opened.append(True))
    monkeypatch.setattr(RunOptions, "on_real_wire", property(lambda self: True))
    options = RunOptions("mock", (still,), ("side_kick",), dry_run=True)
    with pytest.raises(PreflightRefused, match="rehearsal refused: rehearsal side_kick: 0 of 3"):
        run_session(options, SwitchesAtTick(-1), Voice())
    assert not opened


def test_a_dry_run_counts_for_its_clip_alone(tmp_path):
    records = [DryRunRecord("p" * 64, clip * 64, "", "s", "r", "w" * 64, "c") for clip in "ab"]
    records[0].save(tmp_path, {})
    assert records[0].missing(tmp_path, 1.0) is None
    assert records[1].missing(tmp_path, 1.0) == "no dry run has passed with this HAL configuration"
    records[1].save(tmp_path, {})
    assert [record.missing(tmp_path, 1.0) for record in records] == [None, None]
