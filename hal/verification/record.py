"""The record that a robot was verified: for these files, and for the motors and adapters that were there."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from core.files import write_json

RECORDS = Path(__file__).resolve().parents[2] / "runs" / "verified"
LISTED = 4


@dataclass(frozen=True)
class VerifiedRecord:
    """What a passed check holds for. config_sha256: of the wire's configuration; robot: the robot's name.

    identities: see DeviceInfo.
    """

    config_sha256: str
    robot: str
    identities: Mapping[str, str]

    def path(self, folder: Path) -> Path:
        """Where it is kept: one for each configuration and robot, so that another robot's replaces it."""
        return folder / f"{self.robot}-{self.config_sha256[:16]}.json"

    def save(self, folder: Path, content: Mapping[str, Any]) -> Path:
        """Note that it passed."""
        folder.mkdir(parents=True, exist_ok=True)
        write_json(self.path(folder), {**content, **vars(self), "identities": dict(self.identities)})
        return self.path(folder)

    def problem(self, folder: Path) -> str | None:
        """Why it does not hold: never verified, or not these motors and adapters; None where it holds."""
        try:
            content = json.loads(self.path(folder).read_text(encoding="utf-8"))
            known = dict(content["identities"]) if content["config_sha256"] == self.config_sha256 else None
        except (OSError, ValueError, KeyError, TypeError):
            known = None
        if known is None:
            return "not verified with this configuration: hang the robot up and run hal/verify"
        differ = [name for name in sorted({*known, *self.identities}) if known.get(name) != self.identities.get(name)]
        if not differ:
            return None
        words = [f"{n} is {self.identities.get(n, 'unknown')}, verified was {known.get(n, 'none')}" for n in differ]
        more = f" and {len(differ) - LISTED} more" if len(differ) > LISTED else ""
        return f"another robot than the verified one: {'; '.join(words[:LISTED])}{more}: run hal/verify"
