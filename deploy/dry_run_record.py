"""The note that a dry run has passed, and what it is valid for."""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from core.code import code_version
from core.config import config_file
from core.errors import InputError
from core.files import write_json
from deploy.actor_run import ActorRun
from deploy.options import RunOptions
from hal.contract.types import DeviceInfo
from hal.open import wire_config_sha256
from robot.robot import Robot

RECORDS = Path(__file__).resolve().parents[1] / "runs" / "dry_runs"
DAY_S = 86_400.0


@dataclass(frozen=True)
class DryRunRecord:
    """What a passed dry run is valid for; a SHA-256 each, but for the version of the code.

    clip: of what is followed. identity: of the makers' numbers in the robot; None before they were read.
    """

    policy: str
    clip: str
    stand: str
    settings: str
    robot: str
    wire: str
    code: str
    identity: str | None = None

    def path(self, folder: Path) -> Path:
        """Where it is kept: the latest of this policy with this clip on this wire."""
        return folder / f"{self.policy[:16]}-{self.clip[:16]}-{self.wire[:16]}.json"

    def save(self, folder: Path, content: Mapping[str, Any]) -> Path:
        """Note that it passed now."""
        folder.mkdir(parents=True, exist_ok=True)
        write_json(self.path(folder), {**content, "valid_for": asdict(self), "passed_unix_s": time.time()})
        return self.path(folder)

    def missing(self, folder: Path, days: float) -> str | None:
        """Why what is kept does not do, or None where it does. days: how long it is valid."""
        try:
            content = json.loads(self.path(folder).read_text(encoding="utf-8"))
            passed, age_s = dict(content["valid_for"]), time.time() - float(content["passed_unix_s"])
        except (OSError, ValueError, KeyError, TypeError):
            return "no dry run has passed with this HAL configuration"
        wanted = {name: value for name, value in asdict(self).items() if value is not None}
        if changed := [name for name, value in wanted.items() if passed.get(name) != value]:
            return f"since the dry run that passed, these changed: {', '.join(changed)}"
        if not 0.0 <= age_s <= days * DAY_S:
            return f"the dry run that passed is {age_s / DAY_S:.1f} days old, limit {days:g}"
        return None


def record_of(
    options: RunOptions, robot: Robot, actor: ActorRun, stand: ActorRun | None, info: DeviceInfo | None
) -> DryRunRecord:
    """What the options would run. info: None before the device was opened."""
    return DryRunRecord(
        policy=actor.actor.sha256,
        clip=actor.goals.sha256,
        stand="" if stand is None else stand.actor.sha256,
        settings=_sha256(config_file("deploy", options.settings)),
        robot=_sha256(config_file("robot", options.robot), robot.mjcf_path),
        wire=wire_config_sha256(options.backend, options.hal_config, options.endpoints),
        code=code_version(),
        identity=None if info is None else _identity(info),
    )


def require_records(records: Sequence[tuple[str, DryRunRecord]], folder: Path, days: float) -> None:
    """(name of the policy, its record) each. Raises InputError naming the policies whose dry run does not hold."""
    reasons = {name: record.missing(folder, days) for name, record in records}
    if missing := {name: why for name, why in reasons.items() if why is not None}:
        raise InputError(
            "; ".join(sorted(set(missing.values()))),
            where=f"policy {', '.join(missing)}",
            hint="run the same command with --dry-run first, or add --first-run-ok",
        )


def _identity(info: DeviceInfo) -> str:
    return hashlib.sha256(repr(sorted(info.identities.items())).encode()).hexdigest()


def _sha256(*paths: Path) -> str:
    return hashlib.sha256(b"".join(hashlib.sha256(path.read_bytes()).digest() for path in paths)).hexdigest()
