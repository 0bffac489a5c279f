"""Which joint of a BVH file is which of ours: configs/motion/skeletons/NAME.yaml, or a file of the user's."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from core.config import CONFIGS, load_options
from core.errors import InputError
from core.structured import check_keys, distinct
from motion.human.motion import JOINTS

SKELETONS = CONFIGS / "motion" / "skeletons"
OPTIONAL = frozenset({"spine1", "spine2", "spine3", "left_collar", "right_collar", "head"})
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


@dataclass(frozen=True)
class _Foot:
    at: Literal["ball", "toe"]
    above_sole_m: float


@dataclass(frozen=True)
class _File:
    joints: dict[str, str]
    t_pose: dict[str, dict[str, float]]
    foot: _Foot

    def __post_init__(self) -> None:
        check_keys(self.joints, JOINTS, "joints", optional=OPTIONAL)
        distinct("joints", list(self.joints.values()), "one joint for several")
        for name, channels in self.t_pose.items():
            check_keys(channels, _CHANNELS, f"t_pose.{name}", optional=_CHANNELS)


def load_skeleton_map(path: Path) -> SkeletonMap:
    """The map in a YAML file. Raises InputError naming file and field."""
    if not path.is_file():
        raise InputError("no such file", where="--skeleton", got=path, expected="a mapping like those in " + _bundled())
    file = load_options(_File, path)
    return SkeletonMap(
        name=path.stem,
        joints=file.joints,
        t_pose_deg={
            name: {channel.lower(): angle for channel, angle in pose.items()} for name, pose in file.t_pose.items()
        },
        at_toe=file.foot.at == "toe",
        above_sole_m=file.foot.above_sole_m,
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


def _bundled() -> str:
    return "/".join(SKELETONS.parts[-3:])
