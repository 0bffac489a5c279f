"""Which joint of a BVH file is which of ours: configs/motion/skeletons/NAME.yaml, or a file of the user's."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from core.errors import InputError
from motion.human.motion import JOINTS
from robot.description import check_keys, finite_number, read_yaml

SKELETONS = Path(__file__).resolve().parents[2] / "configs" / "motion" / "skeletons"
OPTIONAL = frozenset({"spine1", "spine2", "spine3", "left_collar", "right_collar", "head"})
_FIELDS = {"joints", "t_pose", "foot"}
_CHANNELS = ("Xrotation", "Yrotation", "Zrotation")


@dataclass(frozen=True)
class SkeletonMap:
    """`joints`: our names to theirs; `t_pose_deg`: rotation channels of their joints in degrees, of a person standing
    upright; where the foot joint lies (at the `toe` or the ball) and how far above the sole."""

    name: str
    joints: Mapping[str, str]
    t_pose_deg: Mapping[str, Mapping[str, float]]
    at_toe: bool
    above_sole_m: float

    def prefix_in(self, names: Collection[str]) -> str | None:
        """What stands before each of our partners in `names` (often nothing), or None where one is missing."""
        pelvis = self.joints["pelvis"]
        prefixes = [name.removesuffix(pelvis) for name in names if name.endswith(pelvis)]
        wanted = set(self.joints.values()) | set(self.t_pose_deg)
        return next((p for p in sorted(prefixes, key=len) if all(p + name in names for name in wanted)), None)


def load_skeleton_map(path: Path) -> SkeletonMap:
    """The map in a YAML file. Raises InputError naming file and field."""
    if not path.is_file():
        raise InputError("no such file", where="--skeleton", got=path, expected="a mapping like those in " + _bundled())
    table = read_yaml(path)
    check_keys(table, _FIELDS, where=str(path))
    joints = table["joints"]
    check_keys(joints, set(JOINTS) - OPTIONAL, where=f"{path}: joints", optional=OPTIONAL)
    theirs = [str(name) for name in joints.values()]
    if repeated := sorted({name for name in theirs if theirs.count(name) > 1}):
        raise InputError("one joint for several", where=f"{path}: joints", got=", ".join(repeated))
    check_keys(table["foot"], {"at", "above_sole_m"}, where=f"{path}: foot")
    if table["foot"]["at"] not in ("ball", "toe"):
        raise InputError("wrong value", where=f"{path}: foot: at", got=table["foot"]["at"], expected="ball or toe")
    above_sole_m = finite_number(table["foot"]["above_sole_m"], where=f"{path}: foot: above_sole_m")
    return SkeletonMap(
        name=path.stem,
        joints={str(ours): str(name) for ours, name in joints.items()},
        t_pose_deg=_t_pose(table["t_pose"], f"{path}: t_pose"),
        at_toe=table["foot"]["at"] == "toe",
        above_sole_m=above_sole_m,
    )


def recognised(names: Collection[str], where: str) -> SkeletonMap:
    """The bundled map that fits a file's joint `names`, of several the one that names most.

    Raises InputError when none does.
    """
    maps = [load_skeleton_map(path) for path in sorted(SKELETONS.glob("*.yaml"))]
    fitting = [m for m in maps if m.prefix_in(names) is not None]
    if not fitting:
        got = ", ".join(list(names)[:8])[:200]
        hint = f"say which joint is which in a file like {_bundled()}/lafan1.yaml: --skeleton FILE"
        known = ", ".join(m.name for m in maps)
        raise InputError(
            "unknown skeleton", where=where, got=f"joints {got} ...", expected=f"that of {known}", hint=hint
        )
    return max(fitting, key=lambda m: len(m.joints))


def _t_pose(table: Any, where: str) -> dict[str, dict[str, float]]:
    if not isinstance(table, Mapping):
        raise InputError("not a table", where=where, got=type(table).__name__, expected="joints, or {}")
    pose = {}
    for name, channels in table.items():
        check_keys(channels, set(), where=f"{where}: {name}", optional=frozenset(_CHANNELS))
        pose[str(name)] = {
            str(channel).lower(): finite_number(value, where=f"{where}: {name}: {channel}")
            for channel, value in channels.items()
        }
    return pose


def _bundled() -> str:
    return "/".join(SKELETONS.parts[-3:])
