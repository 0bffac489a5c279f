import json
from dataclasses import fields, replace

import numpy as np
import pytest

from core.errors import InputError
from policy.inputs import CommandSpec, HeldJoint, MapSpec
from policy.spec import ActorSpec, MotionInfo, ObservationGroup, ObservationTerm
from policy.spec_json import spec_from_json, spec_to_json
from tests.policy.toys import GROUP, toy_motion, toy_spec


def test_json_keeps_every_bit():
    odd = np.array([0.1 + 0.2, 1.0 / 3.0, np.nextafter(1.0, 2.0)])
    spec = toy_spec(default_pos_rad=odd, kp=odd, action_scale=odd)
    back = spec_from_json(spec_to_json(spec))
    for name in ("default_pos_rad", "kp", "kd", "action_scale"):
        assert getattr(back, name).tolist() == getattr(spec, name).tolist()
    assert back.motion.root_height_m == 0.1 + 0.2
    assert back.motion.start_joint_pos_rad.tolist() == spec.motion.start_joint_pos_rad.tolist()
    assert back.observations == spec.observations
    assert back.joint_names == spec.joint_names
    assert back.provenance == spec.provenance
    assert spec_to_json(back) == spec_to_json(spec)


def test_a_spec_without_motion_survives_too():
    assert spec_from_json(spec_to_json(toy_spec(motion=None))).motion is None


def test_a_scalar_action_scale_is_stored_per_joint():
    assert toy_spec(action_scale=0.25).action_scale.tolist() == [0.25, 0.25, 0.25]


def test_arrays_are_copies_and_read_only():
    kp = np.array([1.0, 2.0, 3.0])
    spec = toy_spec(kp=kp)
    kp[0] = 9.0
    assert spec.kp[0] == 1.0
    with pytest.raises(ValueError):
        spec.kp[0] = 2.0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"kp": [100.0, -150.0, 40.0]}, "kp: not usable, got knee -150.0, expected 0 or more"),
        ({"kd": [2.0, 4.0, -0.1]}, "kd: not usable, got ankle -0.1, expected 0 or more"),
        ({"action_scale": [0.25, 0.0, 0.3]}, "action_scale: not usable, got knee 0.0, expected above 0"),
        ({"kp": [1.0, 2.0]}, "kp: wrong length, got shape (2,), expected 3 numbers"),
        ({"kp": [1.0, np.nan, 2.0]}, "kp: not finite, got [1.0, nan, 2.0], expected 3 finite numbers"),
        ({"default_pos_rad": ["a", 1, 2]}, "default_pos_rad: not all numbers"),
        ({"joint_names": ("hip", "knee", "hip")}, "joint_names: given twice, got hip, expected each name once"),
        ({"joint_names": ()}, "joint_names: empty, expected at least one name"),
        ({"joint_names": ("hip", "", "b")}, "joint_names: no name, got '', expected a non-empty string"),
        ({"action_clip": 0.0}, "action_clip: not usable, got 0.0, expected a finite number above 0"),
        ({"action_clip": float("inf")}, "action_clip: not usable, got inf, expected a finite number above 0"),
        ({"control_period_s": -0.02}, "control_period_s: not usable, got -0.02, expected seconds in (0, 1]"),
        ({"observations": ()}, "observations: empty, expected at least one name"),
        ({"observations": (GROUP, GROUP)}, "observations: given twice, got obs, expected each name once"),
        ({"history_start": "ones"}, "history_start: unknown, got 'ones', expected zeros or repeat"),
        ({"robot": ""}, "robot: no name, got '', expected a non-empty string"),
        (
            {"schema_version": 7},
            "schema_version: unknown schema version, got 7, expected 1 or 2; use the version of kata that exported the "
            "actor, or export it again with this one",
        ),
        (
            {"motion": toy_motion(start_joint_pos_rad=np.zeros(2))},
            "motion: start_joint_pos_rad: wrong length, got 2 numbers, expected 3",
        ),
    ],
)
def test_an_unusable_spec_is_refused(changes, text):
    with pytest.raises(InputError) as caught:
        toy_spec(**changes)
    assert str(caught.value).startswith(text)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"fps": 0.0}, "motion: fps: not usable, got 0.0, expected a number above 0"),
        ({"num_frames": 1}, "motion: num_frames: not usable, got 1, expected 2 or more"),
        ({"duration_s": 2.0}, "motion: duration_s: inconsistent, got 2.0, expected (num_frames - 1) / fps = 1.0"),
        ({"sha256": "AB"}, "motion: sha256: no SHA-256, got AB, expected 64 hex digits"),
        ({"root_height_m": float("nan")}, "motion: root_height_m: not usable, got nan, expected a finite number"),
        ({"start_joint_pos_rad": [0.0, np.inf, 0.0]}, "motion: start_joint_pos_rad: not finite"),
    ],
)
def test_an_unusable_motion_is_refused(changes, text):
    with pytest.raises(InputError) as caught:
        toy_motion(**changes)
    assert str(caught.value).startswith(text)


@pytest.mark.parametrize(
    ("lags", "scale", "clip", "text"),
    [
        ((), 1.0, 1.0, "observation term 'x': unusable lags, got []"),
        ((-1,), 1.0, 1.0, "observation term 'x': unusable lags, got [-1]"),
        ((1, 1), 1.0, 1.0, "observation term 'x': unusable lags, got [1, 1]"),
        ((0.5,), 1.0, 1.0, "observation term 'x': unusable lags, got [0.5]"),
        ((10**9,), 1.0, 1.0, "observation term 'x': unusable lags, got [1000000000]"),
        ((0,), 0.0, 1.0, "observation term 'x': scale: not usable, got 0.0"),
        ((0,), float("nan"), 1.0, "observation term 'x': scale: not usable, got nan"),
        ((0,), 1.0, -1.0, "observation term 'x': clip: not usable, got -1.0"),
    ],
)
def test_an_unusable_term_is_refused(lags, scale, clip, text):
    with pytest.raises(InputError) as caught:
        ObservationTerm("x", lags, scale, clip)
    assert str(caught.value).startswith(text)


def test_an_empty_group_is_refused():
    with pytest.raises(InputError, match="observation group 'obs': no terms, expected at least one"):
        ObservationGroup("obs", ())


def edited(**changes) -> str:
    return json.dumps(json.loads(spec_to_json(toy_spec())) | changes)


def without(key: str) -> str:
    document = json.loads(spec_to_json(toy_spec()))
    del document[key]
    return json.dumps(document)


TERM = {"term": "dof_pos", "lags": [0], "scale": 1.0, "clip": 100.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "actor_spec: malformed JSON"),
        ("[" * 100_000, "actor_spec: malformed JSON"),
        ("[]", "actor_spec: wrong type, got [], expected a mapping"),
        (without("kp"), "actor_spec.kp: missing key, got action_clip, "),
        (edited(colour="red"), "actor_spec.colour: unknown key, expected one of robot, "),
        (edited(schema_version=3), "schema_version: unknown schema version, got 3, expected 1 or 2"),
        (edited(schema_version="1"), "schema_version: unknown schema version, got '1', expected 1 or 2"),
        (without("schema_version"), "schema_version: unknown schema version, got None, expected 1 or 2"),
        (edited(kp=[1.0, float("nan"), 2.0]), "actor_spec: not a finite number, got NaN"),
        (edited(kp=[1.0, "2.0", 2.0]), "kp[1]: wrong type, got '2.0', expected a number"),
        (edited(kp=[1.0, True, 2.0]), "kp[1]: wrong type, got True, expected a number"),
        (edited(kp=4.0), "kp: wrong type, got 4.0, expected a list"),
        (edited(joint_names="hip"), "joint_names: wrong type, got 'hip', expected a list"),
        (edited(joint_names=["hip", 3, "ankle"]), "joint_names[1]: wrong type, got 3, expected text"),
        (edited(provenance=[]), "provenance: wrong type, got [], expected a mapping"),
        (edited(motion="bow"), "motion: wrong type, got 'bow', expected a mapping"),
        (edited(observations=[{"name": "obs"}]), "observations[0 obs].terms: missing key, got name"),
        (
            edited(observations=[{"name": "obs", "terms": [TERM, TERM | {"lags": 0}]}]),
            "observations[0 obs].terms[1 dof_pos].lags: wrong type, got 0, expected a list",
        ),
        (
            edited(observations=[{"name": "obs", "terms": [TERM | {"noise": 1}]}]),
            "observations[0 obs].terms[0 dof_pos].noise: unknown key, expected one of term, ",
        ),
        (
            edited(observations=[{"name": "obs", "terms": [{key: TERM[key] for key in ("term", "lags", "clip")}]}]),
            "observations[0 obs].terms[0 dof_pos].scale: missing key, got term, lags, clip",
        ),
        (without("motion"), "actor_spec.motion: missing key, got "),
        ('{"kp": 1, "kp": 2}', "actor_spec: key given twice, got kp, expected each key once"),
    ],
)
def test_unusable_json_is_refused(text, message):
    with pytest.raises(InputError) as caught:
        spec_from_json(text)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


COMMAND = CommandSpec("heading", ("speed_m_s", "turn_rad_s"), ((0.0, 1.5), (-1.0, 1.0)), (0.0, 0.0), 0.5)
MAP = MapSpec("ground", (-0.4, 0.0, 0.4), (-0.2, 0.2), 1.0, 0.1)
HELD = HeldJoint("wrist", 0.3, 20.0, 1.0)


def test_what_schema_2_adds_survives():
    term = ObservationTerm("reference_joint_pos", (0, 1), ticks=(1, 2, 4, 8))
    group = ObservationGroup("obs", (term, ObservationTerm("command", of="heading")))
    spec = toy_spec(
        follows="any_clip", motion=None, observations=(group,), commands=(COMMAND,), maps=(MAP,), held_joints=(HELD,)
    )
    back = spec_from_json(spec_to_json(spec))
    assert back.observations == (group,)
    assert (back.follows, back.commands, back.maps, back.held_joints) == ("any_clip", (COMMAND,), (MAP,), (HELD,))


def test_a_document_of_schema_1_is_read_as_it_was_written():
    document = json.loads(spec_to_json(toy_spec()))
    for name in ("follows", "commands", "maps", "held_joints"):
        del document[name]
    for term in document["observations"][0]["terms"]:
        del term["ticks"], term["of"]
    document["schema_version"] = 1
    spec = spec_from_json(json.dumps(document))
    assert (spec.schema_version, spec.follows, spec.held_joints) == (1, "clip", ())
    assert spec.observations == toy_spec().observations


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"follows": "the sun"}, "follows: unknown, got 'the sun', expected clip or any_clip or commands"),
        ({"commands": (COMMAND, COMMAND)}, "commands: given twice, got heading"),
        ({"held_joints": (HeldJoint("hip", 0.0, 1.0, 1.0),)}, "joint_names and held_joints: given twice, got hip"),
    ],
)
def test_parts_of_schema_2_that_contradict_each_other_are_refused(changes, text):
    with pytest.raises(InputError) as caught:
        toy_spec(**changes)
    assert str(caught.value).startswith(text)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (
            lambda: replace(COMMAND, rest=(2.0, 0.0)),
            "command 'heading': rest of speed_m_s: out of range, got 2.0",
        ),
        (lambda: replace(COMMAND, rest=(0.0,)), "command 'heading': rest: wrong length, got 1, expected 2"),
        (
            lambda: replace(COMMAND, timeout_s=0.0),
            "command 'heading': timeout_s: not usable, got 0.0, expected",
        ),
        (lambda: replace(MAP, x_m=(0.0, 0.0)), "map 'ground': x_m: no grid, got [0.0, 0.0], expected finite numbers"),
        (lambda: replace(MAP, max_age_s=-1.0), "map 'ground': max_age_s: not usable, got -1.0"),
        (lambda: replace(HELD, kp=-1.0), "held joint 'wrist': kp: not usable, got -1.0, expected 0 or more"),
        (lambda: ObservationTerm("x", ticks=(2, 1)), "observation term 'x': unusable ticks, got [2, 1]"),
    ],
)
def test_unusable_parts_of_schema_2_are_refused(make, text):
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value).startswith(text)


def test_provenance_must_be_finite():
    with pytest.raises(InputError, match="actor_spec: cannot be written as JSON"):
        spec_to_json(toy_spec(provenance={"error_mm": float("nan")}))


def test_replace_validates_again():
    with pytest.raises(InputError, match="history_start"):
        replace(toy_spec(), history_start="")


def test_every_field_is_in_the_document():
    document = json.loads(spec_to_json(toy_spec()))
    assert set(document) == {entry.name for entry in fields(ActorSpec)}
    assert set(document["motion"]) == {entry.name for entry in fields(MotionInfo)}
