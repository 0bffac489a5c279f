"""A loop in a process of its own, on a wire: arguments are backend, its configuration, the control period in seconds,
endpoints as JSON, and how it ends.

It acknowledges what a busy machine does to its pace while the last word on standard input is PATIENT, as at first.
"""

import json
import os
import select
import sys
import time

from core.clock import MonotonicClock
from hal.contract.types import DeviceError
from hal.open import open_backend
from tests.hal.rigs import G1, hold

DRIVES_S = 0.3
PATIENT, EARNEST = "patient", "earnest"


def last_word(before: str) -> str:
    if not select.select([0], [], [], 0.0)[0]:
        return before
    return [before, *os.read(0, 1024).decode().split()][-1]


if __name__ == "__main__":
    name, config, period, addresses, end = sys.argv[1:]
    period_s, endpoints = float(period), json.loads(addresses)
    clock = MonotonicClock()
    word, earnest_s = PATIENT, None
    with open_backend(name, G1, clock, control_period_s=period_s, config=config, endpoints=endpoints) as backend:
        print("open", flush=True)
        while True:
            try:
                faults = backend.read().faults
            except DeviceError:
                faults = ()
            word = last_word(word)
            if faults and word == PATIENT:
                backend.acknowledge()
            if word == EARNEST and earnest_s is None:
                earnest_s = clock.now_s()
            backend.write(hold(G1))
            clock.sleep_until(clock.now_s() + period_s)
            if end != "never" and earnest_s is not None and clock.now_s() - earnest_s > DRIVES_S:
                print(time.monotonic(), flush=True)
                if end == "raise":
                    raise RuntimeError("something in the loop")
                break
