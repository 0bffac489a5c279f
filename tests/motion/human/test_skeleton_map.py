"""Mapping files of BVH skeletons: the bundled ones, and what is said of wrong ones."""

import pytest

from core.errors import InputError
from motion.human.motion import JOINTS
from motion.human.skeleton_map import OPTIONAL, SKELETONS, load_skeleton_map, recognised

BUNDLED = sorted(path.stem for path in SKELETONS.glob("*.yaml"))
GOOD = (SKELETONS / "mocapbank.yaml").read_text()


def test_the_bundled_ones():
    assert BUNDLED == ["cmu", "lafan1", "mixamo", "mocapbank"]


@pytest.mark.parametrize("name", BUNDLED)
def test_each_is_recognised_by_its_own_names(name):
    mapping = load_skeleton_map(SKELETONS / f"{name}.yaml")
    assert set(JOINTS) - OPTIONAL <= set(mapping.joints)
    for prefix in ("", "mixamorig:", "Character1_"):
        names = [prefix + theirs for theirs in mapping.joints.values()]
        assert recognised([*names, "Extra"], "a.bvh").name == name
        assert mapping.prefix_in(names) == prefix
        assert mapping.prefix_in(names[:-1]) is None


WRONG = {
    "missing joint": (("  neck: Neck\n", ""), r"joints\.neck: missing key"),
    "unknown joint": (
        ("  neck: Neck\n", "  neck: Neck\n  tail: Tail\n"),
        r"joints\.tail: unknown key, expected one of pelvis",
    ),
    "one for several": (("neck: Neck", "neck: Head"), "joints: one joint for several, got Head"),
    "unknown field": (
        ("t_pose: {}", "t_pose: {}\nunits: cm"),
        "units: unknown key, expected one of joints, t_pose, foot",
    ),
    "no foot": (("foot:", "feet:"), "feet: unknown key, expected one of joints, t_pose, foot"),
    "where": (("at: toe", "at: heel"), r"foot\.at: unknown choice, got heel, expected one of ball, toe"),
    "depth": (("0.028", "deep"), r"foot\.above_sole_m: wrong type, got 'deep', expected a number in m"),
    "t_pose list": (("t_pose: {}", "t_pose: [1]"), r"t_pose: wrong type, got \[1\], expected a mapping"),
    "t_pose channel": (
        ("t_pose: {}", "t_pose: {Hips: {Wrotation: 3}}"),
        r"t_pose\.Hips\.Wrotation: unknown key, expected one of Xrotation, Yrotation, Zrotation",
    ),
    "t_pose value": (
        ("t_pose: {}", "t_pose: {Hips: {Zrotation: x}}"),
        r"t_pose\.Hips\.Zrotation: wrong type, got 'x', expected a number",
    ),
    "not YAML": (("joints:", "joints: ["), "not a readable YAML file"),
    "a list": ((GOOD, "- 1"), "wrong type, got a list, expected a mapping"),
}


@pytest.mark.parametrize(("change", "message"), WRONG.values(), ids=WRONG)
def test_errors_name_file_and_field(tmp_path, change, message):
    assert change[0] in GOOD
    (tmp_path / "my.yaml").write_text(GOOD.replace(*change))
    with pytest.raises(InputError, match=rf"my\.yaml(: {message})"):
        load_skeleton_map(tmp_path / "my.yaml")


def test_no_file(tmp_path):
    with pytest.raises(InputError, match=r"--skeleton: no such file, got .*no\.yaml, expected a mapping like those in"):
        load_skeleton_map(tmp_path / "no.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"binary\.yaml: not a readable YAML file"):
        load_skeleton_map(tmp_path / "binary.yaml")
