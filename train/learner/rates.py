"""The adaptive learning rate."""

from dataclasses import dataclass

from train.learner.settings import LearnerSettings


@dataclass
class Rates:
    """Up when the policy moves less than wanted, down when more (factor-two dead band)."""

    value: float
    settings: LearnerSettings
    iterations: int = 0

    @property
    def kl_target(self) -> float:
        """Steps shrink as 1/iteration does (Robbins and Monro, 1951), which ends what chance does to the weights."""
        s = self.settings
        return s.kl_target if s.kl_decay is None else s.kl_target / (1.0 + self.iterations / s.kl_decay)

    def adapt(self, kl: float) -> None:
        """Move the rate after an observed divergence."""
        s = self.settings
        low, high = s.learning_rate_range
        if kl > 2.0 * self.kl_target:
            self.value = max(low, self.value / s.kl_factor)
        elif kl < 0.5 * self.kl_target:
            self.value = min(high, self.value * s.kl_factor)
