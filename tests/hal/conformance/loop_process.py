"""A loop in a process of its own, on a wire: arguments are backend, its configuration, the control period in seconds,
endpoints as JSON, and how it ends.

Until standard input says otherwise, it acknowledges what a busy machine does to its pace.
"""

import json
import select
import sys
import time

from core.clock import MonotonicClock
from hal.contract.types import DeviceError
from hal.open import open_backend
from tests.hal.rigs import G1, hold

DRIVES_S = 0.3


def said_enough() -> bool:
    return bool(select.select([sys.stdin], [], [], 0.0)[0])


if __name__ == "__main__":
    name, config, period, addresses, end = sys.argv[1:]
    period_s, endpoints = float(period), json.loads(addresses)
    clock = MonotonicClock()
    serious_s = None
    with open_backend(name, G1, clock, control_period_s=period_s, config=config, endpoints=endpoints) as backend:
        print("open", flush=True)
        while True:
            try:
                faults = backend.read().faults
            except DeviceError:
                faults = ()
            if serious_s is None and said_enough():
                serious_s = clock.now_s()
            if faults and serious_s is None:
                backend.acknowledge()
            backend.write(hold(G1))
            clock.sleep_until(clock.now_s() + period_s)
            if end != "never" and serious_s is not None and clock.now_s() - serious_s > DRIVES_S:
                print(time.monotonic(), flush=True)
                if end == "raise":
                    raise RuntimeError("something in the loop")
                break
