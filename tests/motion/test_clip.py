"""The clip: what it accepts, what it refuses, and its file."""

import dataclasses

import numpy as np
import pytest

from core.errors import InputError
from motion.clip import Clip, clip_from_bytes, clip_to_bytes, load_clip, save_clip
from motion.library import CLIPS
from world.scene import Box, Scene

BOXES = Scene(0.1, (Box((0.3, 0.0, 0.2), (0.1, 0.2, 0.1), 0.5), Box((0.0, 1.0, 0.15), (0.1, 0.1, 0.05))))

REFUSED = {
    "fps zero": ("fps", 0.0, "fps"),
    "fps negative": ("fps", -30.0, "fps"),
    "fps nan": ("fps", float("nan"), "fps"),
    "fps text": ("fps", "30", "fps"),
    "fps bool": ("fps", True, "fps"),
    "joint twice": ("joint_names", ("hip", "hip"), "joint_names: duplicate joints, got hip"),
    "joint without name": ("joint_names", ("hip", " "), "joint_names"),
    "no joints": ("joint_names", (), "joint_names"),
    "joint no text": ("joint_names", ("hip", 3), "joint_names"),
    "fewer joint names": ("joint_names", ("hip",), r"joint_pos_rad: wrong shape, got \(5, 2\), expected \(N, 1\)"),
    "root shape": ("root_pos_w", np.zeros((5, 2)), r"root_pos_w: wrong shape, got \(5, 2\), expected \(N, 3\)"),
    "one frame": ("root_pos_w", np.zeros((1, 3)), "root_pos_w: wrong shape"),
    "root flat": ("root_pos_w", np.zeros(15), "root_pos_w: wrong shape"),
    "root complex": ("root_pos_w", np.zeros((5, 3), complex), "root_pos_w: wrong type"),
    "root object": ("root_pos_w", np.full((5, 3), None), "root_pos_w: wrong type"),
    "root millimetres": ("root_pos_w", np.full((5, 3), 1500.0), "root_pos_w: frame 0: out of range"),
    "frames differ": ("root_pos_w", np.zeros((6, 3)), "numbers of frames differ"),
    "quat xyzw off": ("root_quat_wxyz", np.tile([1.0, 1.0, 0.0, 0.0], (5, 1)), "root_quat_wxyz: frame 0"),
    "quat zero": ("root_quat_wxyz", np.zeros((5, 4)), "root_quat_wxyz: frame 0"),
    "joints in degrees": ("joint_pos_rad", np.full((5, 2), 45.0), "joint_pos_rad: frame 0: out of range"),
    "contact negative": ("contact", np.full((5, 2), -0.1), "contact: frame 0"),
    "contact above one": ("contact", np.full((5, 2), 1.1), "contact: frame 0"),
    "contact one column": ("contact", np.ones((5, 1)), "contact: wrong shape"),
    "source number": ("source", 5, "source: wrong type"),
}


@pytest.mark.parametrize(("field", "value", "message"), REFUSED.values(), ids=REFUSED)
def test_wrong_field_is_named(fields, field, value, message):
    with pytest.raises(InputError, match=message):
        Clip(**(fields | {field: value}))


@pytest.mark.parametrize("field", ["root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_not_finite_names_field_and_frame(fields, field, value):
    array = fields[field].copy()
    array[3, 1] = value
    with pytest.raises(
        InputError, match=f"{field}: frame 3: not finite, got {value} in column 1, expected finite numbers"
    ):
        Clip(**(fields | {field: array}))


def test_length_and_duration(fields):
    clip = Clip(**fields)
    assert (clip.num_frames, clip.num_joints) == (5, 2)
    assert clip.duration_s == pytest.approx(4.0 / 30.0)


def test_arrays_are_own_and_read_only(fields):
    clip = Clip(**fields)
    fields["contact"][0] = 0.0
    assert clip.contact[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        clip.root_pos_w[0] = 0.0


def test_saved_and_loaded_is_the_same(fields, tmp_path):
    clip = Clip(**fields)
    save_clip(clip, tmp_path / "a.npz")
    loaded = load_clip(tmp_path / "a.npz")
    for field in dataclasses.fields(Clip):
        np.testing.assert_array_equal(getattr(loaded, field.name), getattr(clip, field.name))
    assert loaded.sha256 == clip.sha256


def test_numpy_reads_the_file_without_pickle(fields, tmp_path):
    save_clip(Clip(**fields), tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        np.testing.assert_array_equal(file["joint_pos_rad"], fields["joint_pos_rad"])
        assert file["joint_names"].tolist() == ["hip", "knee"]
        assert file["fps"] == 30.0


def test_a_file_that_numpy_wrote_loads(fields, tmp_path):
    np.savez_compressed(tmp_path / "a.npz", **{k: np.asarray(v) for k, v in fields.items()})
    assert load_clip(tmp_path / "a.npz").sha256 == Clip(**fields).sha256


def test_float32_and_column_order_load(fields, tmp_path):
    arrays = {k: np.asarray(v) for k, v in fields.items()}
    arrays["joint_pos_rad"] = np.asfortranarray(arrays["joint_pos_rad"], dtype=np.float32)
    np.savez(tmp_path / "a.npz", **arrays)
    loaded = load_clip(tmp_path / "a.npz")
    np.testing.assert_array_equal(loaded.joint_pos_rad, fields["joint_pos_rad"].astype(np.float32))


def test_equal_clips_give_equal_bytes(fields, monkeypatch):
    first = clip_to_bytes(Clip(**fields))
    monkeypatch.setattr("time.time", lambda: 2e9)
    assert clip_to_bytes(clip_from_bytes(first)) == first


def test_digest_follows_the_motion_not_the_texts(fields):
    clip = Clip(**fields)
    assert dataclasses.replace(clip, source="elsewhere", license="", created_by="").sha256 == clip.sha256
    moved = clip.joint_pos_rad + 1e-12
    for change in ({"joint_pos_rad": moved}, {"fps": 31.0}, {"joint_names": ("knee", "hip")}):
        assert dataclasses.replace(clip, **change).sha256 != clip.sha256


def test_failed_save_leaves_the_old_file_and_no_other(fields, tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    save_clip(Clip(**fields), path)
    before = path.read_bytes()

    def full_disk(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(InputError, match="No space left"):
        save_clip(Clip(**(fields | {"fps": 60.0})), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_save_into_nowhere_or_under_another_ending(fields, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        save_clip(Clip(**fields), tmp_path / "missing" / "a.npz")
    with pytest.raises(InputError, match=r"\.npz"):
        save_clip(Clip(**fields), tmp_path / "a.csv")


def test_a_scene_is_written_as_numbers_and_read_back(fields, tmp_path):
    clip = Clip(**fields, scene=BOXES)
    save_clip(clip, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        first, second = [0.3, 0.0, 0.2, 0.1, 0.2, 0.1, 0.5], [0.0, 1.0, 0.15, 0.1, 0.1, 0.05, 0.0]
        assert file["scene"].tolist() == [0.1, *first, *second]
    loaded = load_clip(tmp_path / "a.npz")
    assert loaded.scene == BOXES
    assert loaded.sha256 == clip.sha256 != Clip(**fields).sha256
    assert clip_to_bytes(loaded) == clip_to_bytes(clip)


def test_a_clip_on_flat_ground_has_the_file_and_the_digest_that_it_always_had():
    content = (CLIPS / "steps.npz").read_bytes()
    clip = clip_from_bytes(content)
    assert clip_to_bytes(clip) == content
    assert clip.sha256 == "5f6d6acb87f78253d3e03d7adb2ea3ce46d2f8b2e512093d311a64d150539192"


WRONG_SCENES = {
    "not a box": (np.zeros(5), r"a\.npz: scene: wrong shape or type, got shape \(5,\)"),
    "flat box": (
        np.array([0.0, 0, 0, 0, 0.1, 0.0, 0.1, 0]),
        r"a\.npz: scene\.boxes\[0\]\.half_size_m\[1\]: out of range",
    ),
    "not finite": (np.array([np.nan]), r"a\.npz: scene\.floor_m: not finite"),
    "text": (np.array(["0"]), r"a\.npz: scene: wrong shape or type"),
    "too many": (np.ones(1 + 7 * 1000), r"a\.npz: scene: wrong shape or type.*at most 256 boxes"),
}


@pytest.mark.parametrize(("scene", "message"), WRONG_SCENES.values(), ids=WRONG_SCENES)
def test_a_wrong_scene_in_a_file_is_named(fields, tmp_path, scene, message):
    np.savez(tmp_path / "a.npz", **{k: np.asarray(v) for k, v in fields.items()}, scene=scene)
    with pytest.raises(InputError, match=message):
        load_clip(tmp_path / "a.npz")
