"""What happens between iterations: judging, reporting, saving, stopping. Another one is a class of its own here."""

from train.hooks.checkpointing import Checkpointing
from train.hooks.evaluation import Best, EvaluationHook
from train.hooks.hook import Hook
from train.hooks.reporting import Reporting
from train.hooks.stopping import Budget, Stopping

__all__ = ["Best", "Budget", "Checkpointing", "EvaluationHook", "Hook", "Reporting", "Stopping"]
