"""A loop in a process of its own, for tests that kill or freeze it: commands every 20 ms, for ever."""

import sys
import time
from pathlib import Path

from hal.contract.types import NoState
from tests.hal.rigs import G1, PERIOD_S, hold
from tests.hal.wire.fake import fake_backend

if __name__ == "__main__":
    end = sys.argv[2]
    with fake_backend(journal=Path(sys.argv[1])) as backend:
        begun_s = time.monotonic()
        while True:
            try:
                backend.read()
            except NoState:
                time.sleep(PERIOD_S)
                continue
            backend.write(hold(G1))
            time.sleep(PERIOD_S)
            if end == "exit" and time.monotonic() - begun_s > 0.3:
                sys.exit(5)
