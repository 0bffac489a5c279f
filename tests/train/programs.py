"""Programs of benchmarks/ as modules, and others as processes that leave out what takes long."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
_LIGHTLY = """
import runpy, sys
from tests.train.conftest import lightly

del sys.argv[0]
with lightly():
    runpy.run_path(sys.argv[0], run_name="__main__")
"""


def load(name: str) -> ModuleType:
    """benchmarks/NAME.py, new."""
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for their module
    spec.loader.exec_module(module)
    return module


def lightly_started(program: Path) -> list[str]:
    """The command that runs a program as it is, but lightly; PYTHONPATH names the repository."""
    return [sys.executable, "-P", "-c", _LIGHTLY, str(program)]
