"""The joints of the G1 in the orders in which files hold them without saying so."""

_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_WAIST = ("waist_yaw", "waist_roll", "waist_pitch")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
_DEPTH = {name: depth for chain in (_LEG, (*_WAIST, *_ARM)) for depth, name in enumerate(chain)}

# The maker's order: limb by limb, which is also MuJoCo's.
JOINTS_29 = (
    *(f"{side}_{joint}_joint" for side in ("left", "right") for joint in _LEG),
    *(f"{joint}_joint" for joint in _WAIST),
    *(f"{side}_{joint}_joint" for side in ("left", "right") for joint in _ARM),
)
# The same without wrists: the robot of PBHC.
JOINTS_23 = tuple(name for name in JOINTS_29 if "wrist" not in name)


def by_depth(joints: tuple[str, ...]) -> tuple[str, ...]:
    """`joints` as Isaac Lab orders them: first all next to the pelvis, then the next ones of all limbs, and so on."""
    return tuple(sorted(joints, key=lambda name: _DEPTH[_stem(name)]))


def link_names(joints: tuple[str, ...]) -> tuple[str, ...]:
    """The bodies that `joints` move, in their order, behind the pelvis."""
    moved = ("torso_link" if name == "waist_pitch_joint" else f"{name.removesuffix('_joint')}_link" for name in joints)
    return ("pelvis", *moved)


def _stem(joint: str) -> str:
    return joint.removesuffix("_joint").removeprefix("left_").removeprefix("right_")
