import sys

import numpy as np
import onnx
import pytest

from core.errors import InputError
from policy.metadata import community_keys, read_metadata, write_metadata
from policy.spec_json import spec_to_json
from tests.policy.toys import set_metadata, toy_spec, write_actor, write_graph


def test_what_is_written_is_read_back(tmp_path):
    path = write_actor(tmp_path / "a.onnx", toy_spec(), b"\x00clip\xff")
    metadata = read_metadata(path)
    assert spec_to_json(metadata.spec) == spec_to_json(toy_spec())
    assert metadata.motion_npz == b"\x00clip\xff"


def test_writing_again_replaces_ours_and_keeps_the_rest(tmp_path):
    path = write_actor(tmp_path / "a.onnx")
    set_metadata(path, "author", "somebody")
    write_metadata(path, toy_spec(action_clip=5.0, motion=None))
    metadata = read_metadata(path)
    assert metadata.spec.action_clip == 5.0
    assert metadata.motion_npz is None
    keys = [entry.key for entry in onnx.load(str(path)).metadata_props]
    assert len(keys) == len(set(keys))
    assert "author" in keys
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.onnx"]


def test_reading_needs_no_onnx_package(tmp_path, monkeypatch):
    path = write_actor(tmp_path / "a.onnx")
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert read_metadata(path).spec.robot == "toy"
    with pytest.raises(InputError, match=r"writing an actor needs the onnx package; install it with: pip install"):
        write_metadata(path, toy_spec())


def test_community_keys_are_comma_separated_and_unrounded(tmp_path):
    spec = toy_spec(action_scale=np.array([0.07450066059, 1.0 / 3.0, 0.1 + 0.2]))
    path = write_actor(tmp_path / "a.onnx", spec)
    stored = {entry.key: entry.value for entry in onnx.load(str(path)).metadata_props}
    assert stored["joint_names"] == "hip,knee,ankle"
    assert stored["joint_stiffness"] == "100.0,150.0,40.0"
    assert stored["joint_damping"] == "2.0,4.0,0.1"
    assert [float(v) for v in stored["default_joint_pos"].split(",")] == spec.default_pos_rad.tolist()
    assert [float(v) for v in stored["action_scale"].split(",")] == spec.action_scale.tolist()
    assert stored["observation_names"] == "dof_pos,base_ang_vel,actions,ref_motion_phase,dof_vel,projected_gravity"
    assert stored["command_names"] == "motion"
    assert set(community_keys(spec)) < set(stored)


def test_a_failed_write_leaves_the_file_alone(tmp_path, monkeypatch):
    path = write_actor(tmp_path / "a.onnx")
    before = path.read_bytes()

    def fail(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("core.files.os.fsync", fail)
    with pytest.raises(InputError, match=r"a.onnx: cannot be written \(No space left on device\)"):
        write_metadata(path, toy_spec(action_clip=5.0))
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.onnx"]


def test_a_clip_needs_its_description(tmp_path):
    path = write_graph(tmp_path / "a.onnx")
    with pytest.raises(InputError, match=r"a clip without its description, expected spec.motion beside motion_npz"):
        write_metadata(path, toy_spec(motion=None), b"clip")


def test_writing_into_what_is_no_model(tmp_path):
    with pytest.raises(InputError, match=r"none.onnx: cannot be read \(No such file or directory\)"):
        write_metadata(tmp_path / "none.onnx", toy_spec())
    junk = tmp_path / "junk.onnx"
    junk.write_bytes(b"\xff\xff\xff junk")
    with pytest.raises(InputError, match=r"junk.onnx: not an ONNX model"):
        write_metadata(junk, toy_spec())
    assert junk.read_bytes() == b"\xff\xff\xff junk"


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("actor_spec", None, "not an actor of this project, got action_scale, command_names, default_joint_pos, "),
        ("actor_spec", "{", "actor_spec: malformed JSON"),
        ("motion_npz", "%%%", "motion_npz: not base64"),
        ("motion_npz", "AAAA", "motion_npz: the embedded motion is damaged: its SHA-256 differs"),
        ("motion_npz_sha256", None, "motion_npz: the embedded motion is damaged: its SHA-256 differs"),
    ],
)
def test_damaged_metadata_is_refused(tmp_path, key, value, text):
    path = write_actor(tmp_path / "a.onnx")
    set_metadata(path, key, value)
    with pytest.raises(InputError) as caught:
        read_metadata(path)
    assert str(caught.value).startswith(f"{path}: {text}")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none.onnx: cannot be read \(No such file or directory\)"):
        read_metadata(tmp_path / "none.onnx")
