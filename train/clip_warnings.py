"""What a run says of its clips before anything is learnt."""

from motion.clip_set import NamedClip
from motion.importers.csv_joints import ASSUMED, rate_assumed
from motion.residual_wrench import Demand, residual_wrench
from train.setup import Setup

NAMED = 3  # clips in a warning


def told_before(setup: Setup) -> list[str]:
    """All of it, a line each."""
    one = [] if setup.clips else feasibility(setup.demands[0], setup.friction_needed)
    return [*assumed_rates(setup), *unsteered(setup), *one, *friction_floor(setup)]


def assumed_rates(setup: Setup) -> list[str]:
    """A line where nothing says how fast a recording is."""
    clips = setup.clips or (NamedClip(setup.config.motion_name, setup.clip),)
    names = [clip.name for clip in clips if rate_assumed(clip.clip)]
    told = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
    way = "motion/process --fps makes a clip that says it; in a manifest the entry's fps does"
    return [f"warning: {told}: {ASSUMED}; {way}"] if names else []


def unsteered(setup: Setup) -> list[str]:
    """A line where an actor of goals is never told speeds alone."""
    goals = setup.config.environment.goals
    if setup.steered or goals is None or "steer" not in goals.names():
        return []
    way = "environment.goals.kinds_of says for which"
    return [f"warning: no clip is learnt by its speeds (goal steer), so a stick will steer nothing; {way}"]


def feasibility(demand: Demand, friction: float) -> list[str]:
    """What the ground can give of a motion, in words: a line, and one more where no robot can do it on its own."""
    residual = residual_wrench(demand)
    lines = [f"forces: {residual}; friction needed: {friction:.2f}"]
    seconds = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in residual.impossible_spans_s())
    if seconds:
        lines.append(
            f"warning: no robot can do {seconds} of the clip on its own exactly as recorded; expect errors or falls "
            "there. Cut the clip (motion/process --start, --end), play it slower (--fps), or correct its contacts."
        )
    return lines


def friction_floor(setup: Setup) -> list[str]:
    """A line where friction is not drawn as low as the configuration says."""
    asked, low = (config.environment.randomization.friction[0] for config in (setup.config, setup.followable))
    why = "the clips need it" if setup.clips else "the clip needs it"
    line = f"friction: drawn from {low:.2f} on, not from {asked:.2f}: {why}"
    return [line] if round(low, 2) > round(asked, 2) else []
