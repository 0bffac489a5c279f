"""How scores are shown: short label, unit and definition of each, wherever numbers stand."""

from dataclasses import dataclass

from motion.metrics import DEFINITIONS


@dataclass(frozen=True)
class Score:
    """One score of an episode. ``key`` is its name in JSON."""

    key: str
    label: str
    unit: str

    @property
    def meaning(self) -> str:
        """Its definition in one line."""
        return DEFINITIONS[self.key]


SCORES = (
    Score("eg_mpbpe_mm", "Eg-mpbpe", "mm"),
    Score("empbpe_mm", "Empbpe", "mm"),
    Score("empjpe_mrad", "Empjpe", "10⁻³ rad"),
    Score("empjve_mrad", "Empjve", "10⁻³ rad/step"),
    Score("empbve_mm", "Empbve", "mm/step"),
    Score("empbae_mm", "Empbae", "mm/step²"),
    Score("contact_error", "contact error", ""),
    Score("episode_length_ratio", "length ratio", ""),
)
AVERAGING = (
    "Each score is a mean over all steps (20 ms) of an episode until its end or fall; shown is mean ± standard "
    "deviation over episodes. Bodies are 24 links, two hands and the head."
)
SURVIVAL = {
    "default": "share of episodes without a fall (pelvis below 0.3 m) and without a safety trip",
    "reference": "share of episodes without a fall (pelvis below 0.3 m)",
}
