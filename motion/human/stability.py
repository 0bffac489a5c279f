"""Where a human's weight is and what can press on the ground: centre of mass, points of the soles and of the body."""

from typing import NamedTuple

import numpy as np

from motion.human.motion import JOINTS, SOLE_POINTS

_POINTS = (*JOINTS, "left_heel", "left_toe", "right_heel", "right_toe")
_HEEL, _BALL_INNER, _BALL_OUTER, _TOE = range(len(SOLE_POINTS))
_STEPS_TO_BALL, _STEPS_TO_TOE = 5, 2  # as the lengths of the foot before and behind the ball: 18 and 7 cm
_POINTS_ON_BONE = 5


class MassSegment(NamedTuple):
    """A part of the body: its share of the mass in percent; its centre lies at `fraction` of the way from the middle of
    the points `start` to the middle of the points `end`."""

    name: str
    percent: float
    start: tuple[str, ...]
    end: tuple[str, ...]
    fraction: float


def _limbs(side: str) -> tuple[MassSegment, ...]:
    def at(name: str) -> tuple[str]:
        return (f"{side}_{name}",)

    return (
        MassSegment(f"{side} upper arm", 2.63, at("shoulder"), at("elbow"), 0.576),
        MassSegment(f"{side} forearm", 1.50, at("elbow"), at("wrist"), 0.457),
        MassSegment(f"{side} hand", 0.585, at("elbow"), at("wrist"), 1.237),
        MassSegment(f"{side} thigh", 14.47, at("hip"), at("knee"), 0.385),
        MassSegment(f"{side} shank", 4.57, at("knee"), at("ankle"), 0.437),
        MassSegment(f"{side} foot", 1.33, at("heel"), at("toe"), 0.421),
    )


# Masses and centres: de Leva (1996), Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters, Table 4, the
# mean of women and men. Its landmarks lie near these joints: cervicale = neck; xiphion = spine2; omphalion = midway
# from pelvis to spine1. The hand's centre is 63 mm beyond the wrist by the lengths in the same table, which is the
# forearm carried on by 24 %; the head's, at the level of the ears, a little beyond the joint that bears the head.
SEGMENTS = (
    MassSegment("head", 6.81, ("neck",), ("head",), 1.3),
    MassSegment("upper trunk", 15.705, ("neck",), ("spine2",), 0.506),
    MassSegment("middle trunk", 15.49, ("spine2",), ("pelvis", "spine1"), 0.451),
    MassSegment("lower trunk", 11.82, ("pelvis", "spine1"), ("left_hip", "right_hip"), 0.552),
    *_limbs("left"),
    *_limbs("right"),
)


def _weights() -> np.ndarray:
    """(P,) weight of each of _POINTS in the centre of mass; they sum to 1."""
    weights = dict.fromkeys(_POINTS, 0.0)
    for segment in SEGMENTS:
        for points, part in ((segment.start, 1.0 - segment.fraction), (segment.end, segment.fraction)):
            for point in points:
                weights[point] += segment.percent * part / len(points)
    values = np.array(list(weights.values()))
    return values / values.sum()


_WEIGHTS = _weights()
# Half the thickness of a grown person's parts, in m; they bear in a kneeling, sitting or lying body.
_FLESH_M = {
    ("pelvis", "spine3"): 0.11,
    ("neck", "head"): 0.09,
    **{(f"{side}_hip", f"{side}_knee"): 0.075 for side in ("left", "right")},
    **{(f"{side}_knee", f"{side}_ankle"): 0.05 for side in ("left", "right")},
    **{(f"{side}_shoulder", f"{side}_elbow"): 0.045 for side in ("left", "right")},
    **{(f"{side}_elbow", f"{side}_wrist"): 0.035 for side in ("left", "right")},
}


def center_of_mass_w(pos_w: np.ndarray, sole_w: np.ndarray) -> np.ndarray:
    """Centre of mass (N,3) of a human, from joints (N,22,3) and soles (N,2,4,3) as in HumanMotion."""
    ends = sole_w[:, :, [_HEEL, _TOE]].reshape(len(sole_w), 4, 3)
    return np.einsum("p,npi->ni", _WEIGHTS, np.concatenate([pos_w, ends], axis=1))


def sole_points_of(sole_w: np.ndarray) -> np.ndarray:
    """Points (N,2,16,3) that stand for the soles (N,2,4,3) in the centre of pressure.

    Evenly along the inner and the outer edge from heel to toe: of the four points alone the two balls would weigh twice
    as much as heel or toe and pull the pressure of a flat foot forward, from half to 61 % of its length; and the
    pressure would jump where a foot rolls from one point to the next.
    """
    heel, toe = sole_w[:, :, None, _HEEL], sole_w[:, :, None, _TOE]
    back = np.linspace(0.0, 1.0, _STEPS_TO_BALL + 1)[:, None]
    front = np.linspace(0.0, 1.0, _STEPS_TO_TOE + 1)[1:, None]
    edges = []
    for ball in (sole_w[:, :, None, _BALL_INNER], sole_w[:, :, None, _BALL_OUTER]):
        edges += [heel + back * (ball - heel), ball + front * (toe - ball)]
    return np.concatenate(edges, axis=2)


def body_points_of(pos_w: np.ndarray) -> np.ndarray:
    """Lowest points (N,P,3) of trunk, head and limbs, from joints (N,22,3); of the hands and feet nothing.

    Flesh gives way: a point that would lie under the ground lies on it.
    """
    along = (np.arange(_POINTS_ON_BONE) + 0.5)[:, None] / _POINTS_ON_BONE
    points = []
    for (start, end), flesh_m in _FLESH_M.items():
        first, last = (pos_w[:, None, JOINTS.index(name)] for name in (start, end))
        points.append(first + along * (last - first) - np.array([0.0, 0.0, flesh_m]))
    lowest = np.concatenate(points, axis=1)
    lowest[..., 2] = np.maximum(lowest[..., 2], 0.0)
    return lowest
