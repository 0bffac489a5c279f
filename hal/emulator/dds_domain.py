"""A DDS domain that nobody on this machine uses."""

import os
import socket

from hal.contract.types import DeviceError

HOST = "127.0.0.1"
# Below these the robot's and simulators' own, above them ports that the machine gives out by itself.
FIRST, COUNT = 10, 90
BASE_PORT, DOMAIN_PORTS, DISCOVERY_OFFSET = 7400, 250, 10


class FreeDomain:
    """A domain's number, reserved until `release`. Raises DeviceError where none is free.

    Discovery by address listens on UDP port 7410 + 250 x domain; whoever holds the TCP port of that number has
    reserved the domain.
    """

    def __init__(self) -> None:
        for attempt in range(COUNT):
            self.number = FIRST + (os.getpid() + attempt) % COUNT
            port = BASE_PORT + DOMAIN_PORTS * self.number + DISCOVERY_OFFSET
            self._reservation = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            try:
                self._reservation.bind((HOST, port))
                self._reservation.listen(1)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(("", port))
            except OSError:
                self._reservation.close()
                continue
            return
        raise DeviceError(f"dds: no free domain from {FIRST} to {FIRST + COUNT - 1}")

    def release(self) -> None:
        """Others may have it."""
        self._reservation.close()
