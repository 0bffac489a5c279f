#!/usr/bin/env -S python3 -P
"""How fast an actor that follows goals walks where a stick asks for one and the same speed all the time.

benchmarks/steering.py --policy goals --json F
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from core.arguments import ArgumentParser, path_argument, positive_count_argument
from core.command import guarded
from core.files import check_output_file, write_json
from deploy.goals.guard import Steer
from deploy.goals.steering import Pilot
from sim2sim.request import EvaluationRequest
from sim2sim.steered import Seat, check_follows_goals, watched

ASKED = (  # m/s forward, m/s to the left, rad/s to the left
    (0.6, 0.0, 0.0), (0.45, 0.0, 0.0), (0.3, 0.0, 0.0), (0.15, 0.0, 0.0), (-0.2, 0.0, 0.0), (-0.4, 0.0, 0.0),
    (0.4, 0.3, 0.0), (0.0, 0.3, 0.0), (0.0, 0.15, 0.0), (0.0, -0.3, 0.0), (0.3, 0.0, 0.5), (0.0, 0.0, 0.8),
)  # fmt: skip
SETTLES_TICKS = 200  # 4 s


class _Held:
    """A pilot whose stick stays where it is."""

    def __init__(self, steer: Steer) -> None:
        self._steer = steer

    def start(self) -> None:
        """See Pilot."""

    def next(self) -> Steer:
        """See Pilot."""
        return self._steer


def held(asked: tuple[float, float, float]) -> Callable[[Seat], Pilot]:
    """A pilot who asks for that alone."""
    return lambda seat: _Held(Steer(*asked))


def measure(policy: str, asked: tuple[float, float, float], request: EvaluationRequest) -> dict[str, Any]:
    """Mean speeds of all episodes after :data:`SETTLES_TICKS`, how far the heading was off, how many lasted."""
    played = [watched(request, policy, episode, held(asked)) for episode in range(request.episodes)]
    done = [speed for _, watch in played for speed in watch.done[SETTLES_TICKS:]]
    off_rad = [off for _, watch in played for off in watch.off_rad]
    forward, left = np.mean(done, axis=0).tolist() if done else (None, None)
    return {
        "asked": dict(zip(("forward_m_s", "left_m_s", "turn_rad_s"), asked, strict=True)),
        "forward_m_s": forward, "left_m_s": left, "heading_error_rad": float(np.mean(off_rad)) if off_rad else None,
        "lasted": sum(score.ended == "completed" for score, _ in played), "episodes": request.episodes,
    }  # fmt: skip


def _told(row: Mapping[str, Any]) -> str:
    def number(value: float | None) -> str:
        return "none" if value is None else f"{value:.3f}"

    asked = ", ".join(f"{value:5.2f}" for value in row["asked"].values())
    walks = ", ".join(number(row[key]) for key in ("forward_m_s", "left_m_s"))
    heading = number(row["heading_error_rad"])
    return f"asked {asked}: walks {walks} m/s, {heading} rad off; {row['lasted']} of {row['episodes']} lasted"


@guarded
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; exit status."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="goals", help="actor that follows goals: name, file or run folder")
    parser.add_argument("--episodes", type=positive_count_argument, default=3, help="of 20 s, for each speed")
    parser.add_argument("--randomize", action="store_true", help="everything randomised")
    parser.add_argument("--json", type=path_argument, metavar="FILE", help="write the rows there")
    args = parser.parse_args(argv)
    check_output_file("--json", args.json)
    check_follows_goals(args.policy)
    request = EvaluationRequest((args.policy,), goal="steer", episodes=args.episodes, randomize=args.randomize)
    rows = []
    for asked in ASKED:
        rows.append(measure(args.policy, asked, request))
        print(_told(rows[-1]), flush=True)
    if args.json:
        write_json(args.json, {"policy": args.policy, "rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
