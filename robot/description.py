"""Read the parts of a robot's description (configs/robot/*.yaml) and check them against its MJCF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from core.errors import InputError
from core.names import check_same_names

CONFIG_FOLDER = Path(__file__).resolve().parents[1] / "configs" / "robot"

BODY_GROUPS = (
    "lower_tracked",
    "upper_tracked",
    "hand_head_tracked",
    "penalized_contact_bodies",
    "randomized_mass_bodies",
    "ankle_bodies",
)
FIELDS = {
    *("name", "mjcf", "root_body", "imu_site", "feet", "soft_limit_factor", "joints", "points"),
    *("randomized_com_body", *BODY_GROUPS),
}
OPTIONAL_FIELDS = frozenset({"meshes"})
_JOINT_FIELDS = {"name", "default_rad", "kp", "kd", "range_rad", "speed_rad_s", "torque_nm"}
_LIMIT_TOLERANCE = 1e-9


def find_robot(name_or_file: str | Path) -> Path:
    """The file that holds a robot given by bundled name or by path."""
    path = Path(name_or_file)
    if path.suffix not in (".yaml", ".yml"):
        path = CONFIG_FOLDER / f"{name_or_file}.yaml"
    if not path.is_file():
        bundled = ", ".join(sorted(p.stem for p in CONFIG_FOLDER.glob("*.yaml")))
        raise InputError("unknown robot", got=name_or_file, expected=f"one of {bundled}, or a .yaml file that exists")
    return path.resolve()


def read_yaml(path: Path) -> dict[str, Any]:
    """The fields of a YAML file; a key given twice is an error."""
    try:
        table = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except (yaml.YAMLError, OmegaConfBaseException, UnicodeDecodeError) as error:
        raise InputError("not a readable YAML file", where=path, got=" ".join(str(error).split())) from error
    if not isinstance(table, dict):
        raise InputError("not a table", where=path, got=type(table).__name__, expected="a mapping of fields")
    return {str(key): value for key, value in table.items()}


def check_keys(table: Any, expected: set[str], *, where: str, optional: frozenset[str] = frozenset()) -> None:
    """Raise InputError unless ``table`` is a mapping with the ``expected`` keys, perhaps some ``optional`` ones."""
    if not isinstance(table, Mapping):
        raise InputError("not a table", where=where, got=repr(table), expected=", ".join(sorted(expected)))
    unknown, missing = set(table) - expected - optional, expected - set(table)
    if unknown or missing:
        faults = [f"{kind} field {', '.join(sorted(names))}" for kind, names in
                  (("unknown", unknown), ("missing", missing)) if names]  # fmt: skip
        raise InputError(" and ".join(faults), where=where, expected=", ".join(sorted(expected)))


def compile_mjcf(mjcf: Path, *, where: str) -> mujoco.MjModel:
    """The MJCF as it stands in its file."""
    if not mjcf.is_file():
        raise InputError("no such file", where=where, got=mjcf.resolve())
    try:
        return mujoco.MjSpec.from_file(str(mjcf)).compile()
    except ValueError as error:
        raise InputError("MuJoCo cannot read the model", where=where, got=" ".join(str(error).split())) from error


def joint_table(rows: Any, *, where: str) -> dict[str, Any]:
    """The joint table's columns as read-only arrays (J,), by the names that ``Robot`` gives them."""
    if not isinstance(rows, list) or not rows:
        raise InputError("not a list of joints", where=where, got=type(rows).__name__, expected="a list of rows")
    for i, row in enumerate(rows):
        name = row.get("name", f"row {i}") if isinstance(row, Mapping) else f"row {i}"
        check_keys(row, _JOINT_FIELDS, where=f"{where}: {name}", optional=frozenset({"damping_kd"}))
    rows = [{"damping_kd": row["kd"], **row} for row in rows]
    names = tuple(str(row["name"]) for row in rows)
    check_same_names(names, tuple(dict.fromkeys(names)), where=where)

    def column(field: str) -> np.ndarray:
        return _frozen([finite_number(row[field], where=f"{where}: {row['name']}: {field}") for row in rows])

    ranges = [_range(row["range_rad"], where=f"{where}: {row['name']}: range_rad") for row in rows]
    table = {
        "joint_names": names,
        "default_pos_rad": column("default_rad"),
        "kp": column("kp"),
        "kd": column("kd"),
        "damping_kd": column("damping_kd"),
        "pos_lower_rad": _frozen([lower for lower, _ in ranges]),
        "pos_upper_rad": _frozen([upper for _, upper in ranges]),
        "vel_limit_rad_s": column("speed_rad_s"),
        "torque_limit_nm": column("torque_nm"),
    }
    _check_signs(table, where=where)
    return table


def _check_signs(table: dict[str, Any], *, where: str) -> None:
    for field in ("kp", "kd", "damping_kd", "vel_limit_rad_s", "torque_limit_nm"):
        for name, value in zip(table["joint_names"], table[field]):
            if value <= 0:
                raise InputError(f"{field} of {name}", where=where, got=value, expected="a positive number")
    outside = (table["default_pos_rad"] < table["pos_lower_rad"]) | (table["default_pos_rad"] > table["pos_upper_rad"])
    for i in np.flatnonzero(outside):
        limits = f"{table['pos_lower_rad'][i]} to {table['pos_upper_rad'][i]}"
        got = table["default_pos_rad"][i]
        raise InputError(f"default_rad of {table['joint_names'][i]}", where=where, got=got, expected=limits)


def check_joints(joints: dict[str, Any], model: mujoco.MjModel, *, where: str) -> None:
    """Names, order, ranges and torque limits must be those of the MJCF."""
    kinds = {model.joint(i).name: int(model.jnt_type[i]) for i in range(model.njnt)}
    hinges = tuple(name for name, kind in kinds.items() if kind == mujoco.mjtJoint.mjJNT_HINGE)
    names = joints["joint_names"]
    check_same_names(names, hinges, where=where)
    if names != hinges:
        first = next(i for i, name in enumerate(names) if name != hinges[i])
        raise InputError(
            f"row {first} is not in the MJCF's order", where=where, got=names[first], expected=hinges[first]
        )
    index = [model.joint(name).id for name in names]
    columns = {
        "range_rad (lower)": (joints["pos_lower_rad"], model.jnt_range[index, 0]),
        "range_rad (upper)": (joints["pos_upper_rad"], model.jnt_range[index, 1]),
        "torque_nm": (joints["torque_limit_nm"], model.jnt_actfrcrange[index, 1]),
    }
    for field, (got, expected) in columns.items():
        for i in np.flatnonzero(~np.isclose(got, expected, rtol=0, atol=_LIMIT_TOLERANCE)):
            what = f"{field} of {names[i]} is not the MJCF's"
            raise InputError(what, where=where, got=got[i], expected=expected[i])


def check_root(root: str, imu_site: Any, model: mujoco.MjModel, *, where: str) -> None:
    """The MJCF's first body must float freely, be the robot's root, and carry no other joint than hinges below it."""
    free = model.nq > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE and model.jnt_bodyid[0] == 1
    if not free or model.body(root).id != 1 or model.nq != 7 + model.njnt - 1:
        raise InputError("the root must be the MJCF's first body, on a free joint", where=where, got=root)
    sites = [model.site(i).name for i in range(model.nsite)]
    if imu_site not in sites:
        raise InputError(
            "imu_site is not in the MJCF", where=where, got=imu_site, expected=f"one of {', '.join(sites)}"
        )


def known_names(values: Any, known: Sequence[str], *, where: str) -> tuple[str, ...]:
    """``values`` as a tuple, if each is in ``known`` and none repeats."""
    if not isinstance(values, list):
        raise InputError("not a list of names", where=where, got=values)
    for value in values:
        if not isinstance(value, str) or value not in known:
            raise InputError("unknown name", where=where, got=value, expected=f"one of {', '.join(known)}")
    if len(set(values)) != len(values):
        raise InputError("repeated name", where=where, got=", ".join(values))
    return tuple(values)


def known_name(value: Any, known: Sequence[str], *, where: str) -> str:
    """``value``, if it is in ``known``."""
    return known_names([value], known, where=where)[0]


def offset_rows(rows: Any, fields: set[str], *, where: str) -> list[dict[str, Any]]:
    """Rows with ``fields``, each one's ``offset_m`` as three finite numbers."""
    if not isinstance(rows, list):
        raise InputError("not a list", where=where, got=rows, expected=f"rows of {', '.join(sorted(fields))}")
    table = []
    for i, row in enumerate(rows):
        check_keys(row, fields, where=f"{where}: row {i}")
        offset = row["offset_m"]
        if not isinstance(offset, list) or len(offset) != 3:
            raise InputError("offset_m", where=f"{where}: row {i}", got=offset, expected="3 numbers")
        numbers = tuple(finite_number(value, where=f"{where}: row {i}: offset_m") for value in offset)
        table.append({**row, "offset_m": numbers})
    return table


def soft_factor(value: Any, *, where: str) -> float:
    """The share of each joint's range that counts as inside the soft limits."""
    factor = finite_number(value, where=where)
    if not 0 < factor <= 1:
        raise InputError("out of range", where=where, got=factor, expected="above 0, at most 1")
    return factor


def _range(value: Any, *, where: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError("wrong length", where=where, got=value, expected="[lower, upper]")
    lower, upper = (finite_number(v, where=where) for v in value)
    if lower >= upper:
        raise InputError("empty range", where=where, got=value, expected="lower < upper")
    return lower, upper


def finite_number(value: Any, *, where: str) -> float:
    """``value`` as a float, if it is one."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError("not a finite number", where=where, got=repr(value))
    return float(value)


def _frozen(values: Sequence[float] | np.ndarray) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def sole_points_m(model: mujoco.MjModel, foot: str, *, where: str) -> np.ndarray:
    """Lowest points (S, 3) of the colliding spheres of ``foot``, in its frame."""
    body = model.body(foot).id
    balls = np.flatnonzero(
        (model.geom_bodyid == body)
        & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
        & (model.geom_contype | model.geom_conaffinity > 0)
    )
    if len(balls) < 3:
        raise InputError(
            "a foot needs a sole of 3 or more colliding spheres", where=where, got=f"{len(balls)} on {foot}"
        )
    drop = np.zeros((len(balls), 3))
    drop[:, 2] = model.geom_size[balls, 0]
    return _frozen(model.geom_pos[balls] - drop)
