"""A folder with an actor that follows goals, one that stands, a clip and a script; a port and who sends there."""

import socket

import pytest

from deploy.goals.message import encode
from deploy.goals.udp import LOOPBACK, UdpPort
from motion.clip import save_clip
from tests.deploy.goals.toys import write_goal_actor
from tests.deploy.toys import PERIOD_S, still_clip, write_standing_actor

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


class Sender:
    def __init__(self, port):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.to, self.number = port.address, 0

    def raw(self, *datagrams):
        for datagram in datagrams:
            self.socket.sendto(datagram, self.to)

    def say(self, *speeds):
        self.number += 1
        self.raw(encode(self.number, *speeds))


@pytest.fixture
def port():
    with UdpPort(LOOPBACK, 0, PERIOD_S) as opened:
        yield opened


@pytest.fixture
def sender(port):
    made = Sender(port)
    yield made
    made.socket.close()
