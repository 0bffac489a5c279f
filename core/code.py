"""Which code is running."""

import hashlib
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

CODE = Path(__file__).resolve().parents[1]


def code_version(folder: Path = CODE) -> str:
    """The commit of the clone, with ``-dirty-`` and a hash of the uncommitted changes; else the package's version."""
    commit = _git(folder, "describe", "--always", "--dirty", "--abbrev=12")
    if not commit:
        try:
            return version("kata")
        except PackageNotFoundError:
            return "unknown"
    name = commit.decode().strip()
    if not name.endswith("-dirty"):
        return name
    return f"{name}-{hashlib.sha256(_git(folder, 'diff', 'HEAD')).hexdigest()[:8]}"


def _git(folder: Path, *arguments: str) -> bytes:
    """What git says, or nothing."""
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return b""
    return done.stdout if done.returncode == 0 else b""
