"""How well an actor follows what it is shown of a motion: MaskedMimic's figures (section 6), beside ours.

All places are the simulator's true ones; the reference is laid where the robot stood and looked at the start.
"""

import numpy as np

from motion.metrics import Track
from policy.goals import KINDS, POINTS
from robot.robot import Robot

FARTHEST_M = 0.5  # the mean error of a successful episode never exceeds it
ROOT = 0  # of the tracked points
ALONG_GROUND = np.array([1.0, 1.0, 0.0])
GOAL_DEFINITIONS = {
    "success": "share of episodes that ended with the clip, links (vr3: head and hands) never 0.5 m off in the mean",
    "mpjpe_mm": "MPJPE: distance of a body from its reference in the world, mean over the links and steps",
    "mpojpe_mm": "MPOJPE: the same of what was shown alone: the points, and the root where its velocity was",
    "path_error_mm": "distance of the root along the ground from where the path has it by then, mean over steps",
    "reach_error_mm": "distance of the right hand from its target, both seen from below their root, mean over steps",
}


def goal_scores(track: Track, reference: Track, kind: str, robot: Robot, *, completed: bool) -> dict[str, float | None]:
    """One episode of T steps, T ≥ 0, by key of GOAL_DEFINITIONS; what a kind has no score for is left out.

    track, reference: done and asked, row by row, in the robot's world. completed: whether it reached its end.
    """
    done_w, asked_w = track.body_pos_w, reference.body_pos_w
    error_m = np.linalg.norm(done_w - asked_w, axis=-1)
    links, shown = np.arange(len(robot.body_names)), shown_points(kind, robot)
    judged = error_m[:, shown if kind == "vr3" else links].mean(axis=1)
    scores = {"success": float(completed and judged.size > 0 and judged.max() <= FARTHEST_M)}
    errors = {"mpjpe_mm": error_m[:, links]}
    if shown.size:
        errors["mpojpe_mm"] = error_m[:, shown]
    if kind == "path":
        errors["path_error_mm"] = np.linalg.norm((done_w - asked_w)[:, ROOT] * ALONG_GROUND, axis=-1)
    if kind == "reach":
        hand = robot.tracked_index([robot.goal_points[POINTS.index("right_hand")]])[0]
        seen = [bodies[:, hand] - bodies[:, ROOT] * ALONG_GROUND for bodies in (done_w, asked_w)]
        errors["reach_error_mm"] = np.linalg.norm(seen[0] - seen[1], axis=-1)
    return scores | {name: 1e3 * float(values.mean()) if values.size else None for name, values in errors.items()}


def shown_points(kind: str, robot: Robot) -> np.ndarray:
    """Which of the tracked points a kind of goal shows: all links with the joints, else its points and its root."""
    parts = KINDS[kind]
    if "joints" in parts:
        return np.arange(len(robot.body_names))
    names = [name for point, name in zip(POINTS, robot.goal_points, strict=True) if point in parts]
    root = [ROOT] if "place" in parts else []
    return np.array([*root, *robot.tracked_index(names)], dtype=int)
