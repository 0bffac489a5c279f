"""What distillation asks of a student, whichever it is."""

from collections.abc import Mapping
from typing import Any, Protocol

from torch import Tensor, nn

from train.distil.losses import Prediction
from train.learner.networks import ActorNetwork
from train.learner.storage import Minibatch


class Student(Protocol):
    """Acts and predicts. A module.

    Attributes:
        ways: names of how it can act; the first is how it is deployed.
        noise_size: normal numbers that are drawn for each episode.
        actor: what is deployed of it.
    """

    ways: tuple[str, ...]
    noise_size: int
    actor: ActorNetwork

    def parameters(self) -> Any:
        """Of all its networks."""
        ...

    def look(self, observations: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What it needs of the observations (B, ·) to act and to learn, by name; it is kept."""
        ...

    def act(self, way: str, seen: Mapping[str, Tensor], noise: Tensor) -> Tensor:
        """Raw actions (n, J) of what :meth:`look` returned, with the episodes' noise (n, ``noise_size``)."""
        ...

    def predict(self, samples: Minibatch) -> Prediction:
        """Of n samples: what :meth:`look` returned, ``noise`` of the episode and the teacher's ``label``."""
        ...

    def normalize(self, samples: Minibatch) -> None:
        """Take in what was seen since the last call."""
        ...

    def beside_actor(self) -> Mapping[str, nn.Module]:
        """What else of it learns, by name."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Weights, buffers."""
        ...

    def load_state_dict(self, state: Mapping[str, Any]) -> Any:
        """Restore what :meth:`state_dict` returned."""
        ...
