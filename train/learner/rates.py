"""The adaptive learning rate."""

from dataclasses import dataclass

from train.learner.settings import LearnerSettings


@dataclass
class Rates:
    """Up when the policy moves less than wanted, down when more (factor-two dead band)."""

    value: float
    settings: LearnerSettings

    def adapt(self, kl: float) -> None:
        """Move the rate after an observed divergence."""
        s = self.settings
        low, high = s.learning_rate_range
        if kl > 2.0 * s.kl_target:
            self.value = max(low, self.value / s.kl_factor)
        elif kl < 0.5 * s.kl_target:
            self.value = min(high, self.value * s.kl_factor)
