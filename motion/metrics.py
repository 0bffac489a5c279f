"""How well a motion was followed: the paper's metrics (appendix D.2, Eq. 21-26), contact error and episode length.

Row t of a track is the state after control tick t, row t of its reference the motion at the same instant. Every
`*_mm` and `*_mrad` function gives one value per step (T,); first and second differences lose the first one or two.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motion.reference import Reference

TRACKING_KEYS = (
    "eg_mpbpe_mm",
    "empbpe_mm",
    "empjpe_mrad",
    "empjve_mrad",
    "empbve_mm",
    "empbae_mm",
    "contact_error",
)
METRIC_KEYS = (*TRACKING_KEYS, "episode_length_ratio")
DEFINITIONS = {
    "eg_mpbpe_mm": "distance of a body from its reference in the world, mean over bodies and steps (Eq. 21)",
    "empbpe_mm": "the same with positions relative to the root (Eq. 22)",
    "empjpe_mrad": "norm of the vector of all joint errors, mean over steps (Eq. 23)",
    "empjve_mrad": "the same for first differences of joint positions per control step (Eq. 24)",
    "empbve_mm": "distance of a body's first difference from the reference's, mean over bodies and steps (Eq. 25)",
    "empbae_mm": "the same for second differences (Eq. 26)",
    "contact_error": "absolute difference of the foot contact masks, mean over feet and steps",
    "episode_length_ratio": "steps until the end or the fall, divided by the steps of the clip",
}


@dataclass(frozen=True)
class Track:
    """A motion as it was performed: body_pos_w (T,B,3) m with the root first, joint_pos_rad (T,J), contact (T,2)
    left and right foot in [0,1], or None where nobody measured it."""

    body_pos_w: np.ndarray
    joint_pos_rad: np.ndarray
    contact: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.joint_pos_rad)


def reference_track(reference: Reference, num_steps: int | None = None) -> Track:
    """What `num_steps` control ticks (default: all) are scored against: the reference at dt, 2 dt, ..."""
    rows = slice(1, (reference.num_ticks if num_steps is None else num_steps) + 1)
    return Track(reference.body_pos_w[rows], reference.joint_pos_rad[rows], reference.contact[rows])


def eg_mpbpe_mm(body_pos_w: np.ndarray, ref_body_pos_w: np.ndarray) -> np.ndarray:
    """Eq. 21: global position error, mean over bodies. (T,B,3) m twice -> (T,) mm."""
    return 1e3 * _mean_distance(body_pos_w, ref_body_pos_w)


def empbpe_mm(body_pos_w: np.ndarray, ref_body_pos_w: np.ndarray) -> np.ndarray:
    """Eq. 22: position error relative to the root (body 0), mean over bodies. (T,B,3) m twice -> (T,) mm."""
    _check_shapes(body_pos_w, ref_body_pos_w)
    return 1e3 * _mean_distance(body_pos_w - body_pos_w[:, :1], ref_body_pos_w - ref_body_pos_w[:, :1])


def empjpe_mrad(joint_pos_rad: np.ndarray, ref_joint_pos_rad: np.ndarray) -> np.ndarray:
    """Eq. 23: norm of the joint error vector. (T,J) rad twice -> (T,) 1e-3 rad."""
    _check_shapes(joint_pos_rad, ref_joint_pos_rad)
    return 1e3 * np.linalg.norm(joint_pos_rad - ref_joint_pos_rad, axis=-1)


def empjve_mrad(joint_pos_rad: np.ndarray, ref_joint_pos_rad: np.ndarray) -> np.ndarray:
    """Eq. 24: Eq. 23 of first differences per step. (T,J) rad twice -> (T-1,) 1e-3 rad."""
    return empjpe_mrad(np.diff(joint_pos_rad, axis=0), np.diff(ref_joint_pos_rad, axis=0))


def empbve_mm(body_pos_w: np.ndarray, ref_body_pos_w: np.ndarray) -> np.ndarray:
    """Eq. 25: Eq. 21 of first differences per step. (T,B,3) m twice -> (T-1,) mm."""
    return eg_mpbpe_mm(np.diff(body_pos_w, axis=0), np.diff(ref_body_pos_w, axis=0))


def empbae_mm(body_pos_w: np.ndarray, ref_body_pos_w: np.ndarray) -> np.ndarray:
    """Eq. 26: Eq. 21 of second differences per step. (T,B,3) m twice -> (T-2,) mm."""
    return eg_mpbpe_mm(np.diff(body_pos_w, n=2, axis=0), np.diff(ref_body_pos_w, n=2, axis=0))


def contact_error(contact: np.ndarray, ref_contact: np.ndarray) -> np.ndarray:
    """Absolute difference of the contact masks, mean over feet. (T,2) twice -> (T,)."""
    _check_shapes(contact, ref_contact)
    return np.abs(contact - ref_contact).mean(axis=-1)


def episode_length_ratio(num_steps: int, num_ticks: int) -> float:
    """Steps of the episode until its end or fall, divided by the control ticks of the clip (paper, section 5.2)."""
    return num_steps / num_ticks


def tracking_metrics(track: Track, ref: Track) -> dict[str, float | None]:
    """Mean of each metric over the episode's steps; None where it cannot be known (no contact, too few steps).

    `ref` may be longer than the track, which ended with a fall; only the steps of the track count.
    """
    steps = len(track)
    body, ref_body = track.body_pos_w, ref.body_pos_w[:steps]
    joint, ref_joint = track.joint_pos_rad, ref.joint_pos_rad[:steps]
    contacts = np.empty(0)
    if track.contact is not None and ref.contact is not None:
        contacts = contact_error(track.contact, ref.contact[:steps])
    per_step = {
        "eg_mpbpe_mm": eg_mpbpe_mm(body, ref_body),
        "empbpe_mm": empbpe_mm(body, ref_body),
        "empjpe_mrad": empjpe_mrad(joint, ref_joint),
        "empjve_mrad": empjve_mrad(joint, ref_joint),
        "empbve_mm": empbve_mm(body, ref_body),
        "empbae_mm": empbae_mm(body, ref_body),
        "contact_error": contacts,
    }
    return {name: float(values.mean()) if values.size else None for name, values in per_step.items()}


def over_episodes(episodes: Sequence[Mapping[str, float | None]]) -> dict[str, dict[str, float] | None]:
    """{"mean", "std"} of every metric over the episodes that know it (population std, 0 for one); None if none does."""
    summary: dict[str, dict[str, float] | None] = {}
    for name in dict.fromkeys(name for episode in episodes for name in episode):
        values = [value for episode in episodes if (value := episode.get(name)) is not None]
        summary[name] = {"mean": float(np.mean(values)), "std": float(np.std(values))} if values else None
    return summary


def _mean_distance(points: np.ndarray, ref_points: np.ndarray) -> np.ndarray:
    """(T,B,3) twice -> distance of each point from its reference, mean over B: (T,)."""
    _check_shapes(points, ref_points)
    return np.linalg.norm(points - ref_points, axis=-1).mean(axis=-1)


def _check_shapes(values: np.ndarray, reference: np.ndarray) -> None:
    if values.shape != reference.shape:
        raise ValueError(f"shapes differ: track {values.shape}, reference {reference.shape}")
