"""How many frames a recording has and how fast they follow one another."""

from core.errors import InputError
from motion.clip import MAX_FPS, MIN_FPS

MAX_FRAMES = 100_000  # a quarter of an hour at 120 frames per second; every array of the way fits in memory


def check_frames(count: int, where: str) -> None:
    """Raise InputError unless there are 2 to MAX_FRAMES frames."""
    if count < 2:
        raise InputError("too few frames", where=where, got=count, expected="2 or more frames")
    if count > MAX_FRAMES:
        raise InputError("too long", where=where, got=f"{count} frames", expected=f"at most {MAX_FRAMES} frames")


def choose_fps(given: float | None, stated: float | None, where: str) -> tuple[float, str]:
    """The frame rate and a sentence about it: the `given` one, else the one `stated` in the file.

    Raises InputError when there is neither, or it is absurd.
    """
    fps = given if given is not None else stated
    if fps is None:
        raise InputError("frame rate not stated", where=where, hint="give it: --fps F")
    if not MIN_FPS <= fps <= MAX_FPS:
        expected = f"{MIN_FPS:g} to {MAX_FPS:g} frames per second"
        hint = None if given is not None else "if the file is wrong, give the true one: --fps F"
        field = "fps" if given is not None else f"{where}: frame rate"
        raise InputError("out of range", where=field, got=f"{fps:g}", expected=expected, hint=hint)
    if given is None:
        return fps, f"{fps:g} frames per second, as the file states."
    other = f", though the file states {stated:g}" if stated is not None and abs(stated - given) > 1e-6 else ""
    return given, f"{given:g} frames per second, as given{other}."
