"""What a run ran on."""

import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch

from core.processes import available_cores
from train.config import TrainConfig

_PACKAGES = ("torch", "mujoco", "numpy", "onnxruntime")


def machine_facts(config: TrainConfig) -> dict[str, str]:
    """Name → value, for people: processor, cores, threads, precision, versions."""
    return {
        "processor": _processor(),
        "cores": str(available_cores()),
        "threads": str(config.threads),
        "precision": config.precision,
        "GPU": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
        "system": platform.platform(),
        "Python": sys.version.split()[0],
        **{name: _version(name) for name in _PACKAGES},
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(errors="replace").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
