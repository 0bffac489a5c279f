"""A folder with an actor that follows goals, one that stands, a clip and a script."""

import pytest

from motion.clip import save_clip
from tests.deploy.goals.toys import write_goal_actor
from tests.deploy.toys import still_clip, write_standing_actor

SCRIPT = """
steps:
  - {for_s: 1.0, forward: 0.4}
  - {for_s: 0.5, turn: 1.0}
  - {path: [[0.3, 0.0], [0.3, 0.2]], speed: 0.3}
  - {for_s: 0.5, reach: [0.3, -0.2, 1.0]}
  - {for_s: 1.0}
  - {clip: still.npz}
  - {clip: still.npz, kind: vr3}
"""


@pytest.fixture(scope="package")
def actors(tmp_path_factory):
    made = tmp_path_factory.mktemp("runs")
    write_goal_actor(made / "goals.onnx")
    write_standing_actor(made / "stand.onnx")
    write_standing_actor(made / "clip.onnx", name="clip")
    save_clip(still_clip(0.5), made / "still.npz")
    (made / "script.yaml").write_text(SCRIPT)
    return made
