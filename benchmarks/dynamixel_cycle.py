#!/usr/bin/env -S python3 -P
"""Rounds of a Dynamixel port by kata's own codec and by dynamixel-sdk, on a pseudo-terminal paced as a wire."""

import multiprocessing
import os
import sys
import time
import tty
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from dynamixel_sdk import GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from core.arguments import ArgumentParser
from core.command import guarded
from core.files import check_output_file, write_json
from hal.dynamixel import protocol2 as p2
from hal.dynamixel.port import ServoPort
from hal.dynamixel.questions import StateQuestions

BYTES, ADDRESS = 23, 124
GOAL_ADDRESS, GOAL_BYTES = 116, 4
BITS_PER_BYTE = 10
Round = Callable[[], int]


def serve(master: int, servos: int, baud: int, silent: int) -> None:
    """Answer sync reads as servos with ids from 1 would, when their bytes have had their time; for ever."""
    parser = p2.PacketParser()
    data = bytes(range(64))
    while True:
        received = os.read(master, 4096)
        due_s = time.monotonic() + len(received) * BITS_PER_BYTE / baud
        for packet in parser.feed(received):
            if packet.instruction == p2.SYNC_READ:
                size = int.from_bytes(packet.params[2:4], "little")
                frames = b"".join(p2.status(i, 0, data[:size]) for i in range(1, servos + 1) if i != silent)
                time.sleep(max(0.0, due_s + len(frames) * BITS_PER_BYTE / baud - time.monotonic()))
                os.write(master, frames)


def own_round(device: str, servos: int, baud: int, period_s: float) -> Round:
    """Sync write of goals and sync read, by hal.dynamixel. The round returns how many servos were heard."""
    port = ServoPort(device, baud)
    port.open()
    questions, ids = StateQuestions(port, fast=False), list(range(1, servos + 1))

    def run() -> int:
        port.send(p2.sync_write(GOAL_ADDRESS, GOAL_BYTES, {i: (2048 + i).to_bytes(4, "little") for i in ids}))
        return len(questions.ask(ids, time.monotonic() + period_s)[1])

    return run


def sdk_round(device: str, servos: int, baud: int, timeout_s: float) -> Round:
    """The same by dynamixel-sdk. timeout_s: of its serial port; the library's own is 0, a busy wait."""
    port: Any = PortHandler(device)
    port.openPort()
    port.setBaudRate(baud)
    port.ser.timeout = timeout_s
    handler = PacketHandler(2.0)
    write, read = GroupSyncWrite(port, handler, GOAL_ADDRESS, GOAL_BYTES), GroupSyncRead(port, handler, ADDRESS, BYTES)
    ids = list(range(1, servos + 1))
    for servo_id in ids:
        read.addParam(servo_id)

    def run() -> int:
        write.clearParam()
        for servo_id in ids:
            write.addParam(servo_id, list((2048 + servo_id).to_bytes(4, "little")))
        write.txPacket()
        read.txRxPacket()
        return sum(bool(read.isAvailable(servo_id, ADDRESS, BYTES)) for servo_id in ids)

    return run


def sdk_stuffs() -> bool:
    """Whether dynamixel-sdk sends the goal -131073, whose bytes begin like a header, with the stuffing it needs."""

    class Tape:
        """Keeps what would be sent."""

        is_using = False
        sent: bytes = b""

        def clearPort(self) -> None:
            """Nothing to clear."""

        def writePort(self, packet: list[int]) -> int:
            """Keep it."""
            self.sent = bytes(packet)
            return len(packet)

    tape = Tape()
    PacketHandler(2.0).write4ByteTxOnly(tape, 1, GOAL_ADDRESS, -131073 & 0xFFFFFFFF)
    return b"\xff\xff\xfd\xfd\xff" in tape.sent


def measure(make: Callable[[str], Round], servos: int, baud: int, silent: int, seconds: float) -> dict[str, float]:
    """Rounds per second, share of a core, and how many servos each round heard."""
    master, slave = os.openpty()
    tty.setraw(slave)
    device = multiprocessing.get_context("fork").Process(target=serve, args=(master, servos, baud, silent), daemon=True)
    device.start()
    try:
        run = make(os.ttyname(slave))
        run()
        rounds = heard = 0
        start_s, start_cpu_s = time.monotonic(), time.process_time()
        while time.monotonic() - start_s < seconds:
            heard += run()
            rounds += 1
        spent_s = time.monotonic() - start_s
        cpu = (time.process_time() - start_cpu_s) / spent_s
        return {"rounds_per_s": rounds / spent_s, "core_percent": 100 * cpu, "heard": heard / rounds}
    finally:
        device.terminate()
        device.join()
        os.close(master)
        os.close(slave)


@guarded
def main() -> int:
    """Print a table and, on request, write it as JSON. Returns the exit code."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--servos", type=int, default=20, metavar="N")
    parser.add_argument("--baud", type=int, nargs="+", default=[1_000_000, 4_000_000], metavar="N")
    parser.add_argument("--seconds", type=float, default=3.0, metavar="S", help="for each row")
    parser.add_argument("--json", type=Path, metavar="F")
    given = parser.parse_args()
    check_output_file("--json", given.json)
    rows = []
    print(f"{given.servos} servos, sync write of {GOAL_BYTES} bytes, sync read of {BYTES}")
    print(f"{'baud':>8} {'silent':>6}  {'by':22} {'rounds/s':>8} {'wire/s':>7} {'core %':>7} {'heard':>6}")
    for baud in given.baud:
        wire_bytes = 14 + given.servos * (1 + GOAL_BYTES) + 14 + given.servos + given.servos * (11 + BYTES)
        ceiling = baud / BITS_PER_BYTE / wire_bytes
        for silent in (0, 1):
            makers: dict[str, Callable[[str], Round]] = {
                "own codec": partial(own_round, servos=given.servos, baud=baud, period_s=2.0 / ceiling),
                "dynamixel-sdk": partial(sdk_round, servos=given.servos, baud=baud, timeout_s=0.0),
                "dynamixel-sdk, timeout": partial(sdk_round, servos=given.servos, baud=baud, timeout_s=0.001),
            }
            for name, make in makers.items():
                found = measure(make, given.servos, baud, silent, given.seconds)
                rows.append({"baud": baud, "silent_servos": silent, "by": name, "wire_per_s": ceiling, **found})
                figures = (
                    f"{found['rounds_per_s']:8.0f} {ceiling:7.0f} {found['core_percent']:7.1f} {found['heard']:6.1f}"
                )
                print(f"{baud:8} {silent:6}  {name:22} {figures}", flush=True)
    stuffed = sdk_stuffs()
    print(f"dynamixel-sdk stuffs a goal of -131073: {'yes' if stuffed else 'no'}")
    own, other = (row["rounds_per_s"] / row["core_percent"] for row in rows[:2])
    print(f"rounds per second of a core's time, own codec over dynamixel-sdk: {own / other:.1f}")
    if given.json:
        write_json(given.json, {"rows": rows, "sdk_stuffs": stuffed})
    return 0


if __name__ == "__main__":
    sys.exit(main())
