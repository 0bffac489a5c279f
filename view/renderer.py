"""Pictures of a MuJoCo state through whatever this machine can draw with."""

from __future__ import annotations

import functools
import os
import subprocess
import sys

import mujoco

from core.errors import InputError
from view.gl import GlRenderer
from view.software import SoftwareRenderer

BACKENDS = ("egl", "osmesa", "software")
FORCE_VARIABLE = "KATA_RENDERER"

_PROBE = "import mujoco.{0}; context = mujoco.{0}.GLContext(16, 16); context.make_current(); context.free()"
_PROBE_TIMEOUT_S = 60.0


def open_renderer(model: mujoco.MjModel, width: int, height: int) -> GlRenderer | SoftwareRenderer:
    """A renderer of ``width`` x ``height`` pixels through EGL or OSMesa, else by MuJoCo's rays.

    ``MUJOCO_GL=egl|osmesa`` is tried first where set; ``KATA_RENDERER=egl|osmesa|software`` allows nothing else.
    Raises InputError on a size that is not positive, and when the forced backend does not work here.
    """
    if width <= 0 or height <= 0:
        raise InputError("picture size", got=f"{width} x {height}", expected="two positive numbers of pixels")
    backend = choose_backend()
    if backend == "software":
        return SoftwareRenderer(model, width, height)
    return GlRenderer(model, width, height, backend)


def choose_backend() -> str:
    """The first of egl, osmesa and software that works on this machine."""
    forced = os.environ.get(FORCE_VARIABLE, "")
    if forced:
        if forced not in BACKENDS:
            raise InputError("unknown renderer", where=FORCE_VARIABLE, got=forced, expected=", ".join(BACKENDS))
        if forced != "software" and not _works(forced):
            hint = f"unset {FORCE_VARIABLE} to draw without it"
            raise InputError("renderer does not work here", where=FORCE_VARIABLE, got=forced, hint=hint)
        return forced
    preferred = os.environ.get("MUJOCO_GL", "").lower()
    for backend in sorted(("egl", "osmesa"), key=lambda name: name != preferred):
        if _works(backend):
            return backend
    _say_what_to_install()
    return "software"


@functools.cache
def _works(backend: str) -> bool:
    """Whether a process of its own can make a GL context: a broken driver may abort, not raise."""
    environment = {**os.environ, "MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
    command = [sys.executable, "-P", "-c", _PROBE.format(backend)]
    try:
        result = subprocess.run(command, env=environment, capture_output=True, timeout=_PROBE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return False
    return result.returncode == 0


@functools.cache
def _say_what_to_install() -> None:
    print(
        "neither EGL nor OSMesa works here: pictures are drawn by the plain software renderer; "
        "for better ones install libegl1 (GPU, or libegl-mesa0 without one) or libosmesa6",
        file=sys.stderr,
    )
