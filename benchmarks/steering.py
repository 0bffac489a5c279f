#!/usr/bin/env -S python3 -P
"""How fast an actor that follows goals walks where a stick asks for one and the same speed all the time.

benchmarks/steering.py --policy goals --json F
"""

import sys
from collections.abc import Callable, Sequence

import numpy as np

from core.arguments import ArgumentParser, path_argument, positive_count_argument
from core.command import guarded
from core.files import check_output_file, write_json
from deploy.goals.guard import Steer
from deploy.goals.steering import Pilot
from sim2sim.request import EvaluationRequest
from sim2sim.steered import Seat, watched

ASKED = (  # m/s forward, m/s to the left, rad/s to the left
    (0.6, 0.0, 0.0), (0.45, 0.0, 0.0), (0.3, 0.0, 0.0), (0.15, 0.0, 0.0), (-0.2, 0.0, 0.0), (-0.4, 0.0, 0.0),
    (0.4, 0.3, 0.0), (0.0, 0.3, 0.0), (0.0, 0.15, 0.0), (0.0, -0.3, 0.0), (0.3, 0.0, 0.5), (0.0, 0.0, 0.8),
)  # fmt: skip
SETTLES_S = 4.0


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


def measure(policy: str, asked: tuple[float, float, float], request: EvaluationRequest) -> dict[str, object]:
    """Mean speeds over all episodes once it has settled, and how many lasted."""
    speeds, lasted, off_rad = [], 0, []
    for episode in range(request.episodes):
        score, watch = watched(request, policy, episode, held(asked))
        lasted += score.ended == "completed"
        off_rad.append(score.heading_error_rad)
        done = np.array(watch.done[round(SETTLES_S / 0.02) :]).reshape(-1, 2)
        speeds.append(done.mean(axis=0) if len(done) else np.full(2, np.nan))
    forward, left = (float(value) for value in np.nanmean(speeds, axis=0))
    return {
        "asked": dict(zip(("forward_m_s", "left_m_s", "turn_rad_s"), asked, strict=True)),
        "forward_m_s": forward, "left_m_s": left, "heading_error_rad": float(np.mean(off_rad)),
        "lasted": lasted, "episodes": request.episodes,
    }  # fmt: skip


@guarded
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; exit status."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="goals", help="actor that follows goals: name, file or run folder")
    parser.add_argument("--episodes", type=positive_count_argument, default=3, help="of 20 s, for each speed")
    parser.add_argument("--randomize", action="store_true", help="everything randomised")
    parser.add_argument("--json", type=path_argument, metavar="FILE", help="write the rows there")
    args = parser.parse_args(argv)
    if args.json:
        check_output_file(args.json, "--json")
    request = EvaluationRequest((args.policy,), goal="steer", episodes=args.episodes, randomize=args.randomize)
    rows = []
    for asked in ASKED:
        rows.append(row := measure(args.policy, asked, request))
        print("asked {:5.2f} {:5.2f} m/s {:4.1f} rad/s".format(*asked), end="  ")
        print("walks {forward_m_s:5.2f} {left_m_s:5.2f} m/s, {heading_error_rad:.3f} rad off,".format(**row), end=" ")
        print(f"{row['lasted']} of {row['episodes']} lasted", flush=True)
    if args.json:
        write_json(args.json, {"policy": args.policy, "rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
