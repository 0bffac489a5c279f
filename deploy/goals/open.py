"""An actor with the source of its goals, from the command line's words."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from core.config import errors_in
from core.errors import InputError
from deploy.actor_run import ActorRun
from deploy.actors import check_start, follows_goals, load_run, load_runs
from deploy.goals.clip import ClipGoal
from deploy.goals.guard import GoalGuard
from deploy.goals.option import GoalOption, parse_goal
from deploy.goals.points import PointGuard
from deploy.goals.ranges import narrowed
from deploy.goals.script import ScriptGoal, Step, load_script
from deploy.goals.settings import GoalSettings
from deploy.goals.steering import SteerGoal
from deploy.goals.udp import UdpPort
from deploy.operator.sticks import Sticks
from deploy.options import RunOptions
from deploy.settings import DeploySettings
from motion.clip_set import open_clips
from motion.reference import Reference
from motion.tables import with_tables
from policy.actor import load_actor, resolve_actor
from policy.metadata import read_metadata
from policy.observation import reference_tables
from policy.spec import ActorSpec, motion_info
from robot.robot import Robot


@dataclass(frozen=True)
class Followed:
    """runs: actors, each with what it follows. judged: likewise, with each clip that is known before.

    sticks: what people steer by, where they do.
    """

    runs: tuple[ActorRun, ...]
    judged: tuple[ActorRun, ...] = ()
    sticks: Sticks | None = None


@dataclass(frozen=True)
class GoalDesk:
    """What opening a source needs of a run. stand: the actor that balances before and after; steering needs it.

    say: for the console. stack: closes what was opened.
    """

    robot: Robot
    settings: DeploySettings
    stand: ActorRun | None
    say: Callable[[str], None]
    stack: contextlib.ExitStack

    def open_all(self, options: RunOptions) -> Followed:
        """What the options ask for: a source of goals, or clips. Raises InputError on any misfit."""
        if options.goal is not None:
            return self.open(parse_goal(options.goal), options.policies[0])
        clips = open_clips(options.motions, self.robot)
        runs = tuple(load_runs(options.policies, clips, self.robot, self.settings.entry))
        if len(runs) > 1 and not options.attended:
            raise InputError("several --policy or --motion", hint="add --interactive: a person chooses between them")
        return Followed(runs, runs)

    def open(self, option: GoalOption, policy: str) -> Followed:
        """Raises InputError on any misfit of source, actor and robot."""
        spec = _spec_that_follows_goals(policy)
        if option.source == "clip":
            run = load_run(policy, option.file, self.robot, self.settings.entry, option.kind)
            return Followed((run,), (run,))
        if self.stand is None or self.stand.clip is None:
            raise InputError("--goal that is steered", got="no stand actor", hint="leave --start reference out")
        standing = standing_for(spec, self.stand, self.robot)
        settings, limits = narrowed(self.settings.goals, spec.provenance)
        self.say(limits)
        guards = (GoalGuard(settings, standing.dt_s), PointGuard(settings, self.robot, standing))
        if option.source == "script":
            return self._scripted(option, policy, settings, standing, *guards)
        if option.source == "udp":
            port = self._listen(option, standing.dt_s)
            return Followed((self._steered(policy, SteerGoal("udp", port, standing, *guards)),))
        sticks = Sticks(settings, standing.dt_s)
        return Followed((self._steered(policy, SteerGoal("stick", sticks, standing, guards[0])),), sticks=sticks)

    def _listen(self, option: GoalOption, period_s: float) -> UdpPort:
        port = self.stack.enter_context(UdpPort(option.address, option.port, period_s))
        host, number = port.address
        self.say(f"goals are taken at udp {host}:{number}")
        self.stack.callback(lambda: self.say(f"goals by udp: {', '.join(f'{n} {k}' for k, n in port.counts.items())}"))
        return port

    def _scripted(
        self,
        option: GoalOption,
        policy: str,
        settings: GoalSettings,
        standing: Reference,
        guard: GoalGuard,
        points: PointGuard,
    ) -> Followed:
        path = Path(option.file)
        script = load_script(path, settings)
        runs, clips = [], []
        for number, step in enumerate(script.steps):
            if step.clip is not None:
                run = self._clip_of(path, number, step, policy)
                assert isinstance(run.goals, ClipGoal)
                runs.append(run)
                clips.append(run.goals)
        goal = ScriptGoal(path.stem, script, clips, standing, settings, guard, points)
        return Followed((self._steered(policy, goal),), tuple(runs))

    def _clip_of(self, path: Path, number: int, step: Step, policy: str) -> ActorRun:
        """A clip by name, beside the script, or where the command runs; it begins where the robot stands."""
        assert step.clip is not None and self.stand is not None
        beside = path.parent / step.clip
        where = f"{path}: steps[{number}].clip"
        with errors_in(where):
            file = beside if beside.is_file() else step.clip
            run = load_run(policy, file, self.robot, self.settings.entry, step.kind)
            check_start(run, self.stand, self.robot, self.settings.entry)
        if run.scene != self.stand.scene:
            raise InputError(
                "not on flat ground", where=where, got="a clip with a scene", hint="play it by --goal clip:"
            )
        return run

    def _steered(self, policy: str, goal: SteerGoal | ScriptGoal) -> ActorRun:
        """The actor takes its start pose from the stand actor's clip."""
        assert self.stand is not None and self.stand.clip is not None
        standing = motion_info(self.stand.clip, goal.name, goal.start_pose_rad)
        return ActorRun(load_actor(policy, self.robot, standing), self.robot, self.settings.entry, goal)


def standing_for(spec: ActorSpec, stand: ActorRun, robot: Robot) -> Reference:
    """What the stand actor follows, with all that a steered actor looks at before it is left to that one."""
    return with_tables(robot, stand.goals.setting, reference_tables(spec.observations))


def _spec_that_follows_goals(policy: str) -> ActorSpec:
    path = resolve_actor(policy)
    spec = read_metadata(path).spec
    if not follows_goals(spec):
        raise InputError("this actor follows clips, not goals", where=path, got="--goal", hint="give --motion instead")
    return spec
